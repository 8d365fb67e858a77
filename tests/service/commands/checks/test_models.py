"""Settings and model files."""

from __future__ import annotations

import shutil
import socket

from service.commands.checks.models import check_models, check_settings
from service.settings import Settings


def test_a_variable_that_means_nothing_is_told_with_what_was_meant():
    environment = {"PHYSNET_HTTP_PROT": "1", "PHYSNET_THREADS": "2", "HOME": "/"}
    first, *others = check_settings(environment, Settings(http_port=0, grpc_port=0))
    assert (first.state, first.mend) == ("warn", "did you mean PHYSNET_HTTP_PORT?")
    assert [check.state for check in others] == ["ok"]


def test_a_port_that_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        warned = [check for check in check_settings({}, Settings(http_port=port, grpc_port=0)) if check.state == "warn"]
    assert [f"127.0.0.1:{port}" in check.found for check in warned] == [True]


def test_a_file_that_was_changed_is_found(model_folders, tmp_path):
    source = model_folders["reconstruction"]
    folder = tmp_path / source.parent.name / source.name
    shutil.copytree(source, folder)
    assert [check.state for check in check_models(Settings(models=tmp_path))] == ["ok"]
    with (folder / "model.onnx").open("ab") as graph:
        graph.write(b"\0")
    (check,) = check_models(Settings(models=tmp_path))
    assert check.state == "fail"
    assert "digest" in check.found
    assert check.mend
