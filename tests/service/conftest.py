"""The models that the service ships with, or those that PHYSNET_MODELS names."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.inference.registry import Models, load_models
from tests.conftest import ROOT


@pytest.fixture(scope="session")
def models_directory() -> Path:
    return Path(os.environ.get("PHYSNET_MODELS", ROOT / "models"))


@pytest.fixture(scope="session")
def models(models_directory: Path) -> Models:
    """Opened once, on one thread."""
    return load_models(models_directory, threads=1)


@pytest.fixture(scope="session")
def model_folders(models: Models, models_directory: Path) -> dict[str, Path]:
    """The folder of the model of each kind."""
    return {manifest.kind: models_directory / manifest.name / manifest.version for manifest in models.manifests}


@pytest.fixture(autouse=True)
def logging_as_before() -> Iterator[None]:
    """`serve` logs to the stderr of its test: what others log afterwards must not go to a stream that is closed."""
    root, uvicorn = logging.getLogger(), logging.getLogger("uvicorn")
    handlers, levels = root.handlers[:], (root.level, uvicorn.level)
    yield
    root.handlers[:] = handlers
    # By `setLevel`, since loggers remember what they were allowed to say.
    root.setLevel(levels[0])
    uvicorn.setLevel(levels[1])
