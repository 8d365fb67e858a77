"""A multipart body, there as a whole, as its parts."""

from __future__ import annotations

from collections.abc import Iterator

from multipart import MultipartError, PushMultipartParser, parse_options_header

from service.core.errors import InvalidRequest

MAX_PARTS = 8
"""A request has three. How long the headers of one may be is the parser's own limit: eight lines of 4 KiB."""


def parts_of(body: bytes, content_type: str) -> Iterator[tuple[str, bytes]]:
    """Name and content of each part, as they stand in the body.

    Args:
        body: The whole body.
        content_type: Header of the request, which names what is between the parts.

    Raises:
        InvalidRequest: It is no multipart/form-data, from the place on where that shows; one that does not end is none.
    """
    _, parameters = parse_options_header(content_type)
    boundary = parameters.get("boundary", "").encode("latin-1")
    name, content = "", b""
    try:
        with PushMultipartParser(boundary, max_segment_count=MAX_PARTS, strict=True) as parser:
            for event in parser.parse(body):
                if event is None:
                    yield name, content
                elif isinstance(event, bytes):
                    # All of the part at once, as the body is there as a whole.
                    content = event
                else:
                    name, content = event.name, b""
    except MultipartError as error:
        raise InvalidRequest(f"The body is not multipart/form-data: {error}.", expected="parts") from None
