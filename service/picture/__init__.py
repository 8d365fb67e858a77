"""Pictures of answers; needs the `pictures` extra (matplotlib). Nothing else in the service draws."""

from service.picture.figure import deformation_picture

__all__ = ["deformation_picture"]
