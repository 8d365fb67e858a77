"""One table from errors to both wires, complete."""

from __future__ import annotations

import grpc
import pytest

from service.api.status import INTERNAL, STATUS, meanings, status_of
from service.core.errors import EmptyObject, PhysNetError


def tree(cls: type[PhysNetError]) -> list[type[PhysNetError]]:
    return [cls, *(below for child in cls.__subclasses__() for below in tree(child))]


@pytest.mark.parametrize("cls", tree(PhysNetError)[1:], ids=lambda cls: cls.__name__)
def test_every_error_has_a_status_of_its_own(cls):
    if not cls.__module__.startswith("service.") or cls.__module__.startswith("service.client"):
        pytest.skip("made up by a test, or the client's own")
    status = STATUS[cls]
    assert 400 <= status.http < 600
    assert hasattr(grpc.StatusCode, status.grpc)
    assert status.meaning.endswith(".")
    # The service's own failures are not the client's fault, and the other way round.
    theirs = ("INVALID_ARGUMENT", "NOT_FOUND", "UNAUTHENTICATED", "RESOURCE_EXHAUSTED")
    assert (status.grpc in theirs) == (status.http < 500)


def test_codes_are_unique():
    codes = [cls.code for cls in STATUS]
    assert len(set(codes)) == len(codes)
    assert set(meanings()) == {*codes, "internal"}


def test_an_error_below_the_table_takes_its_parents_status():
    class NothingAtAll(EmptyObject):
        pass

    assert status_of(NothingAtAll("x")) == STATUS[EmptyObject]


@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt(), PhysNetError("root")])
def test_what_is_not_in_the_table_is_internal(error):
    assert status_of(error) == INTERNAL
