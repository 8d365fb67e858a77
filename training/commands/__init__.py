"""Commands of `physnet-train`, one a module."""
