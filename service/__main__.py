"""The command line: `physnet serve | predict | materials | models`."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from service.core.errors import ModelMismatch, PhysNetError
from service.core.materials import search_materials
from service.settings import Settings

if TYPE_CHECKING:
    from service.core.messages import DeformRequest, DeformResult

OK, FAILED, USAGE, REFUSED = 0, 1, 2, 3

_EPILOG = "exit codes: 0 done, 1 the service or its models failed, 2 wrong usage, 3 the request was refused"

_INTRINSICS = ("fx", "fy", "cx", "cy", "width", "height", "distortion")


class _UsageError(Exception):
    """Something on the command line cannot be used."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    given = _parser().parse_args(_join_negatives(sys.argv[1:] if arguments is None else arguments))
    try:
        return int(given.run(given))
    except _UsageError as error:
        print(f"physnet: {error}", file=sys.stderr)
        return USAGE
    except ValidationError as error:
        for detail in error.errors():
            name = "_".join(str(step) for step in detail["loc"])
            print(f"physnet: setting {name} (PHYSNET_{name.upper()}): {detail['msg']}", file=sys.stderr)
        return USAGE
    except BrokenPipeError:
        return OK
    except OSError as error:
        print(f"physnet: {error}", file=sys.stderr)
        return FAILED
    except ModelMismatch as error:
        print(f"physnet: {error.message}", file=sys.stderr)
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="physnet", description="From one depth frame to the shape an object takes under a push.", epilog=_EPILOG
    )
    commands = parser.add_subparsers(required=True, metavar="serve|predict|materials|models")
    models = argparse.ArgumentParser(add_help=False)
    models.add_argument("--models", type=Path, metavar="DIR", help="directory of the models (PHYSNET_MODELS)")
    models.add_argument("--threads", type=int, metavar="N", help="threads of each network (PHYSNET_THREADS)")
    as_json = argparse.ArgumentParser(add_help=False)
    as_json.add_argument("--json", action="store_true", help="print one JSON document")

    serve = commands.add_parser(
        "serve", parents=[models], help="answer requests over HTTP and gRPC", epilog=_EPILOG,
        description="Serve until SIGTERM. Prints one line on stdout once it answers, `ready http=HOST:PORT "
        "grpc=HOST:PORT`; logs go to stderr. Every setting is also an environment variable: PHYSNET_HOST, …",
    )  # fmt: skip
    serve.add_argument("--host", help="address to listen on (PHYSNET_HOST)")
    serve.add_argument("--http-port", type=int, metavar="PORT", help="0 picks a free one (PHYSNET_HTTP_PORT)")
    serve.add_argument("--grpc-port", type=int, metavar="PORT", help="0 picks a free one (PHYSNET_GRPC_PORT)")
    serve.add_argument("--log-level", choices=["debug", "info", "warning", "error"], help="(PHYSNET_LOG_LEVEL)")
    serve.set_defaults(run=_serve)

    predict = commands.add_parser(
        "predict", parents=[models, as_json], help="answer one request without a service", epilog=_EPILOG
    )
    predict.add_argument("depth", type=Path, help="depth image: 16-bit PNG or .npy")
    predict.add_argument("--intrinsics", type=Path, required=True, metavar="JSON", help="fx fy cx cy width height")
    predict.add_argument("--encoding", help="of the depth file, where it is neither PNG nor .npy")
    predict.add_argument("--unit-m", type=float, metavar="M", help="metres per count")
    predict.add_argument("--mask", type=Path, metavar="PNG", help="pixels of the object; found if absent")
    predict.add_argument("--up", metavar="X,Y,Z", help="against gravity, camera frame; found if absent")
    predict.add_argument("--material", required=True, metavar="NAME|E,NU", help="a name (`physnet materials`) or Pa,ν")
    predict.add_argument("--press", required=True, metavar="U,V|X,Y,Z", help="contact: a pixel, or metres (camera)")
    predict.add_argument("--force", required=True, metavar="N|X,Y,Z", help="N along the viewing ray, or a vector")
    predict.add_argument("--patch-radius-m", type=float, metavar="M", help="radius of the patch that is pressed")
    predict.add_argument("-o", "--output", type=Path, metavar="NPZ", help="write grids and fields here")
    predict.add_argument("--picture", type=Path, metavar="PNG", help="draw the answer (needs physnet[pictures])")
    predict.set_defaults(run=_predict)

    materials = commands.add_parser("materials", parents=[as_json], help="list the named materials", epilog=_EPILOG)
    materials.add_argument("words", nargs="*", help="words that name or description must hold")
    materials.set_defaults(run=_materials)

    listing = commands.add_parser(
        "models", parents=[models, as_json], help="check and list the models", epilog=_EPILOG
    )
    listing.set_defaults(run=_models)
    return parser


def _join_negatives(arguments: Sequence[str]) -> list[str]:
    """`--force -1,0,0` as `--force=-1,0,0`: argparse takes a value that begins with a minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        after_option = joined and re.fullmatch(r"--(up|press|force)", joined[-1])
        if after_option and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _settings(given: argparse.Namespace, *names: str) -> Settings:
    chosen = {name: getattr(given, name) for name in ("models", "threads", *names)}
    return Settings(**{name: value for name, value in chosen.items() if value is not None})


# Imports inside the commands: `physnet materials` need not load ONNX Runtime and a web server.


def _serve(given: argparse.Namespace) -> int:
    from service.app import run

    return run(_settings(given, "host", "http_port", "grpc_port", "log_level"))


def _materials(given: argparse.Namespace) -> int:
    found = search_materials(" ".join(given.words))
    if given.json:
        rows = [
            {
                "name": entry.name,
                "young_modulus_pa": entry.material.young_modulus_pa,
                "poisson_ratio": entry.material.poisson_ratio,
                "young_modulus_range_pa": entry.young_modulus_range_pa,
                "description": entry.description,
                "source": entry.source,
            }
            for entry in found
        ]
        print(json.dumps({"materials": rows}))
        return OK
    for entry in found:
        e_pa, nu = entry.material.young_modulus_pa, entry.material.poisson_ratio
        print(f"{entry.name:20s} E {e_pa:8.2e} Pa  ν {nu:.2f}  {entry.description}")
    return OK


def _models(given: argparse.Namespace) -> int:
    from service.inference.registry import load_models

    settings = _settings(given)
    manifests = load_models(settings.models, settings.threads).manifests
    if given.json:
        print(json.dumps({"models": [manifest.to_json() for manifest in manifests]}))
        return OK
    for manifest in manifests:
        print(f"{manifest.kind:15s} {manifest.name} {manifest.version}  ({settings.models / manifest.name})")
    return OK


def _predict(given: argparse.Namespace) -> int:
    from service.api import convert
    from service.api.problem import ValidationFailed, problem_document
    from service.app import build_pipeline

    request_id = uuid.uuid4().hex
    try:
        files = {"depth": given.depth.read_bytes()}
        if given.mask:
            files["mask"] = given.mask.read_bytes()
        body = convert.parse_body(json.dumps(_request_body(given)).encode())
        request = convert.deform_request(body, max_loads=1, files=files)
        predictor = build_pipeline(_settings(given)).predictor
        began = time.perf_counter()
        result = predictor.predict(request)
        elapsed_ms = 1e3 * (time.perf_counter() - began)
    except ModelMismatch:
        raise
    except (PhysNetError, ValidationFailed) as error:
        problem = problem_document(error, request_id)
        if given.json:
            print(json.dumps(problem))
        else:
            where = f" [{problem['field']}]" if "field" in problem else ""
            print(f"physnet: {problem['code']}{where}: {problem['detail']}", file=sys.stderr)
        return REFUSED
    if given.output:
        given.output.write_bytes(convert.reply_npz(result, request.outputs, request_id, result.timing_ms))
    if given.picture:
        given.picture.write_bytes(_picture(request, result))
    _report(given, result, elapsed_ms)
    return OK


def _request_body(given: argparse.Namespace) -> dict[str, Any]:
    """The same document that a robot would post, so that both are checked by the same rules."""
    try:
        known = dict(json.loads(given.intrinsics.read_text("utf-8")))
    except (ValueError, TypeError) as error:
        raise _UsageError(f"--intrinsics: {given.intrinsics} is not a JSON object: {error}") from None
    camera = {name: known[name] for name in _INTRINSICS if name in known}
    unit_m = given.unit_m if given.unit_m is not None else known.get("depth_unit_m")
    encoding = given.encoding or ("npy" if given.depth.suffix == ".npy" else "png16")
    press = _numbers("--press", given.press, (2, 3))
    contact = {"contact_px": press} if len(press) == 2 else {"contact_m": press}
    force = _numbers("--force", given.force, (1, 3))
    if len(force) == 1:
        force = [force[0] * component for component in _viewing_ray(press, camera)]
    material: dict[str, Any] = {"name": given.material}
    if "," in given.material:
        e_pa, nu = _numbers("--material", given.material, (2,))
        material = {"young_modulus_pa": e_pa, "poisson_ratio": nu}
    return {
        "camera": camera,
        "depth": {"encoding": encoding, "unit_m": unit_m},
        "up": _numbers("--up", given.up, (3,)) if given.up else None,
        "material": material,
        "loads": [{**contact, "force_n": force, "patch_radius_m": given.patch_radius_m}],
        "outputs": ["reconstruction", "deformed", "probability", "displacement"],
    }


def _numbers(option: str, text: str, counts: tuple[int, ...]) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise _UsageError(f"{option}: {text!r} must be {' or '.join(map(str, counts))} numbers separated by commas")
    return numbers


def _viewing_ray(press: list[float], camera: dict[str, Any]) -> list[float]:
    """Unit vector from the camera to the contact: what a robot that pokes at what it sees pushes along."""
    ray = np.array(press)
    if len(press) == 2:
        try:
            ray = np.array(
                [(press[0] - camera["cx"]) / camera["fx"], (press[1] - camera["cy"]) / camera["fy"], 1.0]
            )
        except (KeyError, ZeroDivisionError, TypeError) as error:
            raise _UsageError(f"--intrinsics: no viewing ray without usable fx, fy, cx, cy ({error})") from None
    length = float(np.linalg.norm(ray))
    if length == 0.0:
        raise _UsageError("--press: the camera's own centre has no viewing ray; give --force as a vector")
    return [float(component) for component in ray / length]


def _picture(request: DeformRequest, result: DeformResult) -> bytes:
    from service.core.camera import pixel_to_point
    from service.core.depth import decode_depth
    from service.core.messages import Observation
    from service.picture import deformation_picture

    source, load, answer = request.source, request.loads[0], result.loads[0]
    assert isinstance(source, Observation)
    camera = source.intrinsics
    depth_m = decode_depth(source.depth.encoding, source.depth.data, source.depth.unit_m, camera.width, camera.height)
    contact_m = load.contact_m
    if contact_m is None:
        assert load.contact_px is not None
        contact_m = pixel_to_point(*load.contact_px, depth_m, camera)
    force_n = float(np.linalg.norm(load.force_n))
    material = request.material.name or f"E = {request.material.young_modulus_pa:.3g} Pa"
    return deformation_picture(
        depth_m=depth_m,
        observed=result.observed,
        reconstruction=result.reconstruction,
        deformed=answer.deformed,
        displacement_m=answer.displacement_m,
        grid=result.grid,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
        contact_m=contact_m,
        force_n=load.force_n,
        caption=f"{force_n:.3g} N on {material}: moves {1e3 * answer.max_displacement_m:.1f} mm at most",
    )


def _report(given: argparse.Namespace, result: DeformResult, elapsed_ms: float) -> None:
    answer = result.loads[0]
    flags = sorted(result.flags | answer.flags)
    if given.json:
        print(
            json.dumps(
                {
                    "voxel_size_m": result.grid.pitch_m,
                    "camera_from_grid": result.grid.camera_from_grid.tolist(),
                    "max_displacement_m": answer.max_displacement_m,
                    "mean_displacement_m": answer.mean_displacement_m,
                    "load_number": answer.load_number,
                    "flags": flags,
                    "timing_ms": result.timing_ms,
                }
            )
        )
        return
    print(f"largest displacement  {1e3 * answer.max_displacement_m:.2f} mm")
    print(f"mean displacement     {1e3 * answer.mean_displacement_m:.2f} mm")
    print(f"load number           {answer.load_number:.3g}")
    print(f"voxel                 {1e3 * result.grid.pitch_m:.2f} mm")
    print(f"flags                 {', '.join(flags) or 'none'}")
    print(f"time                  {elapsed_ms:.1f} ms")


if __name__ == "__main__":
    sys.exit(main())
