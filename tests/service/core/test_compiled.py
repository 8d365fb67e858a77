import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.caching import _CacheLocator  # what every place to keep code in derives from

from service.core.compiled import _Kept, compiled, on_compiling

ROOT = Path(__file__).resolve().parents[3]


def sum_of_squares(values: np.ndarray) -> float:
    """A loop."""
    total = 0.0
    for value in values:
        total += value * value
    return total


def test_a_function_is_compiled_and_keeps_its_meaning():
    kernel = compiled(sum_of_squares)
    assert isinstance(kernel, numba.core.registry.CPUDispatcher)
    assert kernel(np.array([3.0, 4.0])) == 25.0
    assert kernel.signatures  # machine code, not the interpreter


def test_what_is_promised_of_the_arguments_and_of_the_order_of_sums_reaches_the_compiler(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    code = {}
    for promised in (False, True):
        monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / str(promised)))
        kernel = compiled(sum_of_squares, apart=promised, reordered=promised)
        assert kernel(np.arange(40.0)) == 20540.0
        (code[promised],) = kernel.inspect_llvm().values()
    assert "fadd reassoc" in code[True] and "fadd reassoc" not in code[False]
    heads = [re.findall(r"^define .*sum_of_squares.*", code[promised], re.M)[0] for promised in (False, True)]
    assert heads[1].count("noalias") > heads[0].count("noalias")  # the result and the error stand apart always


def test_without_a_place_to_keep_code_in_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch):
    def refuse(self: _CacheLocator) -> None:
        raise OSError("Read-only file system")

    for locator in _CacheLocator.__subclasses__():
        monkeypatch.setattr(locator, "ensure_cache_path", refuse)
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(sum_of_squares)
    assert compiled(sum_of_squares)(np.array([3.0, 4.0])) == 25.0


def test_the_test_runs_type_checks_do_not_hide_kernels_from_the_compiler():
    @compiled
    def doubled(value: float) -> float:
        return 2.0 * value

    assert isinstance(doubled, numba.core.registry.CPUDispatcher)
    assert doubled(1.5) == 3.0


def test_compiling_is_told_of_once_and_loading_never(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    told: list[str] = []
    with on_compiling(lambda: told.append("compiling")):
        kernel = compiled(sum_of_squares)
        kernel(np.ones(2))
        kernel(np.ones(2, np.float32))
    assert told == ["compiling"]
    with on_compiling(lambda: told.append("again")):
        assert compiled(sum_of_squares)(np.ones(2)) == 2.0
    assert told == ["compiling"]


def test_code_kept_in_a_form_that_is_not_known_is_left_to_numba(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert compiled(sum_of_squares)(np.ones(2)) == 2.0
    asked: list[object] = []

    def load(self: object, sig: object, target_context: object) -> None:
        asked.append(sig)
        raise AttributeError("no such thing in this version")

    monkeypatch.setattr(_Kept, "_load_bare", load)
    kernel = compiled(sum_of_squares)
    assert kernel(np.ones(2)) == 2.0
    assert len(asked) == 1 and sum(kernel.stats.cache_hits.values()) == 1


def test_a_change_of_a_kernel_or_a_constant_of_another_file_is_noticed(tmp_path: Path):
    def ends(factor: int, offset: int) -> str:
        (tmp_path / "one.py").write_text(
            f"from service.core.compiled import compiled\nOFFSET = {offset}\n@compiled\n"
            f"def scaled(x):\n    return {factor} * x\n"
        )
        script = (
            "import sys, two; print(two.moved(5), sum(two.moved.stats.cache_hits.values()), "
            "*['can compile' for name in sys.modules if name == 'numba.np.npyimpl'])"
        )
        environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            [sys.executable, "-c", script], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True,
            timeout=120,
        ).stdout.strip()  # fmt: skip

    (tmp_path / "two.py").write_text(
        "from one import OFFSET, scaled\nfrom service.core.compiled import compiled\n@compiled\n"
        "def moved(x):\n    return scaled(x) + OFFSET\n"
    )
    assert ends(factor=2, offset=1) == "11 0 can compile"
    assert ends(factor=2, offset=1) == "11 1"  # and what only compiling needs was not even imported
    assert ends(factor=2, offset=4) == "14 0 can compile"  # into which `scaled` was taken, itself not compiled again
    assert ends(factor=13, offset=4) == "69 0 can compile"


def test_code_kept_for_a_class_that_is_gone_since_is_compiled_anew(tmp_path: Path):
    def total(name: str) -> str:
        (tmp_path / "pairs.py").write_text(
            "from typing import NamedTuple\nfrom service.core.compiled import compiled\n"
            f"class {name}(NamedTuple):\n    a: float\n    b: float\n"
            f"some = {name}(1.0, 2.0)\n@compiled\ndef total(pair):\n    return pair.a + pair.b\n"
        )
        script = "import pairs; print(pairs.total(pairs.some), sum(pairs.total.stats.cache_hits.values()))"
        environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.run(
            [sys.executable, "-c", script], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True,
            timeout=120,
        ).stdout.strip()  # fmt: skip

    assert total("Pair") == "3.0 0"
    assert total("Pair") == "3.0 1"
    assert total("Couple") == "3.0 0"
    assert total("Couple") == "3.0 1"
