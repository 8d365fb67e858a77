"""Pictures of the pipeline's pages, drawn again as `make figures` does."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from service.inference.registry import Models, load_models
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def models() -> Models:
    return load_models(ROOT / "models", threads=1)


@pytest.mark.timeout(600)  # a dozen seconds of a quiet core
def test_every_stage_has_a_picture_that_the_code_draws(models: Models, tmp_path: Path):
    pytest.importorskip("matplotlib")
    specification = importlib.util.spec_from_file_location("docs_figures", ROOT / "docs/figures/pipeline.py")
    assert specification is not None and specification.loader is not None
    figures = importlib.util.module_from_spec(specification)
    before = list(sys.path)
    specification.loader.exec_module(figures)
    sys.path[:] = before
    figures.PANEL_PX = 120  # small: what costs time is every ray
    drawn = figures.draw(models, tmp_path)
    pages = sorted((ROOT / "docs/pipeline").glob("*.md"))
    assert {path.stem for path in drawn} == {page.stem for page in pages}
    for path in drawn:
        picture = cv2.imread(str(path))
        assert picture.shape[1] > 240
        # Something is on it.
        assert np.ptp(picture) > 150
        page = (ROOT / "docs/pipeline" / f"{path.stem}.md").read_text("utf-8")
        assert f"../images/pipeline/{path.name}" in page
        assert (ROOT / "docs/images/pipeline" / path.name).is_file()
