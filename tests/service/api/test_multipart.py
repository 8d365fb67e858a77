"""Bodies of forms, as clients write them and as nobody should."""

from __future__ import annotations

import os
import re

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.api.multipart import parts_of
from service.client.http_wire import encode
from service.client.question import Camera, Image, Push, Question
from service.core.errors import InvalidRequest

KIND = "multipart/form-data; boundary=x"
PART = b'--x\r\nContent-Disposition: form-data; name="depth"\r\n\r\nvalue'


def written_by_httpx(files: dict[str, bytes]) -> tuple[str, bytes]:
    request = httpx.Request("POST", "http://x", files=files)
    return request.headers["content-type"], request.read()


@given(st.dictionaries(st.sampled_from(["request", "depth", "mask"]), st.binary(max_size=200), min_size=1))
def test_what_a_client_writes_is_read_byte_for_byte(files):
    kind, body = written_by_httpx(files)
    assert dict(parts_of(body, kind)) == files


@given(st.lists(st.sampled_from([b"\r\n", b"--", b"x", b"--x", b"\r\n-", b"\0", b"a"])).map(b"".join))
def test_what_looks_like_a_boundary_without_being_one_belongs_to_the_part(content):
    if b"--" + b"y" * 4 in content or b"\r\n--yyyy" in b"\r\n" + content:
        return
    body = b'--yyyy\r\nContent-Disposition: form-data; name="depth"\r\n\r\n' + content + b"\r\n--yyyy--\r\n"
    assert dict(parts_of(body, "multipart/form-data; boundary=yyyy")) == {"depth": content}


def test_our_own_client_is_read():
    camera, push, mask = Camera(1.0, 1.0, 1.0, 1.0, 2, 2), Push((0.0, 0.0, 1.0)), Image("png8", b"\r\n--")
    asked = Question(Image("png16", os.urandom(5000)), camera, (push,), "silicone", mask)
    headers, body = encode(asked)
    parts = dict(parts_of(body, headers["Content-Type"]))
    assert list(parts) == ["request", "depth", "mask"]
    assert (parts["depth"], parts["mask"]) == (asked.source.data, b"\r\n--")


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        # curl: quoted nowhere, dashes in the boundary.
        ("multipart/form-data; boundary=----a1",
         b'------a1\r\nContent-Disposition: form-data; name="depth"\r\n\r\nv\r\n------a1--\r\n'),
        # Quoted, with a preamble and an epilogue.
        ('Multipart/Form-Data; charset=utf-8; BOUNDARY="a b"', b"before\r\n--a b\r\nContent-Type: image/png\r\n"
         b"content-disposition:form-data;filename=\"x; name=\\\"mask\\\"\" ; Name=depth\r\n\r\nv\r\n--a b--after"),
        # Without the last line break, which browsers write and others don't.
        (KIND, b'--x\r\nContent-Disposition: form-data; name="depth"\r\n\r\nv\r\n--x--'),
    ],
    ids=["curl", "all that is allowed", "short"],
)  # fmt: skip
def test_every_way_of_writing_it_is_read(kind, body):
    assert list(parts_of(body, kind)) == [("depth", b"v")]


def test_a_form_may_be_empty():
    assert list(parts_of(b"--x--\r\n", KIND)) == []
    body = b'--x\r\nContent-Disposition: form-data; name="mask"\r\n\r\n\r\n--x--'
    assert list(parts_of(body, KIND)) == [("mask", b"")]


@pytest.mark.parametrize(
    ("kind", "body", "why"),
    [
        ("multipart/form-data", b"--x--", "Empty boundary"),
        ("multipart/form-data; boundary=", b"----", "Empty boundary"),
        (KIND, b"", "Unexpected end"),
        (KIND, b"no form at all", "Boundary not found"),
        (KIND, b"x--x\r\n", "in front of first boundary"),
        (KIND, b"--x", "Unexpected end"),
        (KIND, b"--xyz\r\n\r\n", "after first boundary"),
        (KIND, b"--x\r\n\r\nvalue\r\n--x--", "Missing Content-Disposition"),
        (KIND, b"--x\r\nbad header\r\n\r\nvalue\r\n--x--", "Malformed segment header"),
        (KIND, b"--x\r\nContent-Type: image/png\r\n\r\nvalue\r\n--x--", "Missing Content-Disposition"),
        (KIND, b"--x\r\nContent-Disposition: form-data\r\n\r\nvalue\r\n--x--", "Missing name"),
        (KIND, b"--x\r\nA: " + b"a" * 10_000 + b"\r\n\r\nvalue\r\n--x--", "header length exceeded"),
        (KIND, b"--x\r\n" + b"A: a\r\n" * 100 + b"\r\nvalue\r\n--x--", "header count exceeded"),
        (KIND, (PART + b"\r\n") * 9 + b"--x--", "segment count exceeded"),
        (KIND, PART, "Unexpected end"),
        (KIND, PART + b"\r\n--", "Unexpected end"),
        (KIND, PART + b"\r\n--x", "Unexpected end"),
        (KIND, PART + b"\r\n--x\r\n", "Unexpected end"),
    ],
)  # fmt: skip
def test_what_is_no_form_is_named(kind, body, why):
    with pytest.raises(InvalidRequest, match=re.escape(why)):
        list(parts_of(body, kind))


@given(st.binary(max_size=300))
def test_noise_is_refused_and_never_more(noise):
    for body in (noise, b"--x" + noise, b"--x\r\n" + noise):
        try:
            list(parts_of(body, KIND))
        except InvalidRequest:
            pass
