"""Both training loops: they learn, log, validate, stop, and go on as if nothing had happened."""

import csv
import dataclasses
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.training import tiny
from training.configs import FitDeformationConfig, FitReconstructionConfig, OptimizerConfig
from training.data.batches import DeformationSet
from training.data.store import Store, StoreError, code_version
from training.data.view_augmentation import ViewAugmentation
from training.fit_deformation import augmented, fit_deformation, sample_voxels, step_losses, validate
from training.fit_reconstruction import fit_reconstruction
from training.networks.conditions import ConditionConfig
from training.networks.deformation import DeformationNetwork
from training.runs import Run, RunError


class Killed(Exception):
    pass


class KilledAt(Run):
    """A run whose process ends right after an optimizer step."""

    def __init__(self, root: Path, step: int) -> None:
        super().__init__(root)
        self._last = step

    def progress(self, done: int, total: int, first: int, started: float, losses: dict[str, float]) -> None:
        if done == self._last:
            raise Killed


@dataclasses.dataclass(frozen=True)
class Program:
    fit: Callable[..., None]
    config: Any
    data: Path


REAL = ConditionConfig("real")
SHORT = replace(tiny.FIT_DEFORMATION, steps=4, validate_every=2)
SHORT_VIEWS = replace(tiny.FIT_RECONSTRUCTION, steps=4, validate_every=2)
CONFIGS: dict[str, FitDeformationConfig | FitReconstructionConfig] = {
    "deformation": tiny.FIT_DEFORMATION,
    "deformation on the lattice": replace(SHORT, lattice=True),
    "deformation against a critic": replace(SHORT, adversary=tiny.adversary(ConditionConfig())),
    "the paper's deformation": replace(SHORT, network=tiny.PHYSNET, adversary=tiny.adversary(REAL)),
    "reconstruction": tiny.FIT_RECONSTRUCTION,
    "reconstruction of changed views": replace(SHORT_VIEWS, augmentation=ViewAugmentation()),
    "reconstruction in bfloat16": replace(SHORT_VIEWS, bfloat16=True),
    "3D-RecGAN": replace(SHORT_VIEWS, network=tiny.RECGAN, adversary=tiny.adversary(None, given_channels=2)),
}


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(params=list(CONFIGS))
def any_program(request: pytest.FixtureRequest, deformations: Path, views: Path) -> Program:
    config = CONFIGS[request.param]
    if isinstance(config, FitDeformationConfig):
        return Program(fit_deformation, config, deformations)
    return Program(fit_reconstruction, config, views)


@pytest.fixture(params=["deformation", "reconstruction"])
def program(request: pytest.FixtureRequest, deformations: Path, views: Path) -> Program:
    if request.param == "deformation":
        return Program(fit_deformation, tiny.FIT_DEFORMATION, deformations)
    return Program(fit_reconstruction, tiny.FIT_RECONSTRUCTION, views)


@pytest.fixture(scope="module")
def deformations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_deformations(tmp_path_factory.mktemp("boxes"))


def weights(run: Path) -> dict[str, torch.Tensor]:
    network: dict[str, torch.Tensor] = torch.load(run / "checkpoint.pt", weights_only=True)["network"]
    return network


def log(run: Path) -> list[dict[str, str]]:
    with (run / "log.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def leaves(state: Any, name: str = "") -> dict[str, Any]:
    """Everything a checkpoint holds, by its path in it."""
    if isinstance(state, dict):
        return {path: leaf for key, value in state.items() for path, leaf in leaves(value, f"{name}/{key}").items()}
    if isinstance(state, list):
        return {path: leaf for i, value in enumerate(state) for path, leaf in leaves(value, f"{name}/{i}").items()}
    return {name: state}


def test_a_killed_run_goes_on_to_the_very_same_state(any_program: Program, tmp_path: Path) -> None:
    """Weights, moments, rates and, where there is one, the critic with its own: bit for bit."""
    program = any_program
    program.fit(program.data, Run(tmp_path / "whole"), program.config)
    half = program.config.validate_every
    with pytest.raises(Killed):
        program.fit(program.data, KilledAt(tmp_path / "killed", half + 1), program.config)
    assert torch.load(tmp_path / "killed" / "checkpoint.pt", weights_only=True)["step"] == half
    program.fit(program.data, Run(tmp_path / "killed"), program.config)
    whole, resumed = (
        leaves(torch.load(tmp_path / name / "checkpoint.pt", weights_only=True)) for name in ("whole", "killed")
    )
    assert whole.keys() == resumed.keys()
    assert any(path.startswith("/critic/optimizer") for path in whole) == (program.config.adversary is not None)
    different = [
        path
        for path, leaf in whole.items()
        if not (torch.equal(leaf, resumed[path]) if isinstance(leaf, torch.Tensor) else leaf == resumed[path])
    ]
    assert not different
    assert [row["step"] for row in log(tmp_path / "whole")] == [str(half), str(2 * half)]
    assert log(tmp_path / "whole") == log(tmp_path / "killed")


def test_a_run_may_train_on_more_sets_and_says_so(
    program: Program, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It goes on only with the same sets, and validates on the first alone."""
    begun = replace(program.config, steps=3)
    program.fit(program.data, Run(tmp_path / "alone"), begun)
    alone = re.search(r"(\d+) training and (\d+) validation", capsys.readouterr().err)
    program.fit(program.data, Run(tmp_path / "more"), begun, more=[program.data, program.data])
    three = re.search(r"(\d+) training and (\d+) validation", capsys.readouterr().err)
    assert alone and three
    assert (int(three[1]), three[2]) == (3 * int(alone[1]), alone[2])
    saved = torch.load(tmp_path / "more" / "checkpoint.pt", weights_only=True)
    digest = Store(program.data).manifest()["digest"]
    assert [digest in said for said in saved["config"]["more"]] == [True, True]
    assert saved["dataset"]["digest"] == digest
    program.fit(program.data, Run(tmp_path / "more"), begun, more=[program.data, program.data])
    for more in ([], [program.data]):
        with pytest.raises(RunError, match="more"):
            program.fit(program.data, Run(tmp_path / "more"), begun, more=more)


def test_only_a_correction_is_learned_on_the_lattice(deformations: Path, tmp_path: Path) -> None:
    against = replace(SHORT, lattice=True, adversary=tiny.adversary(ConditionConfig()))
    for config in (replace(SHORT, lattice=True, network=tiny.PHYSNET), against):
        with pytest.raises(ValueError, match="only a correction"):
            fit_deformation(deformations, Run(tmp_path), config)


def test_a_run_may_begin_with_the_weights_of_another_and_says_so(program: Program, tmp_path: Path) -> None:
    """One that was killed goes on only with the same beginning, to the very same state."""
    program.fit(program.data, Run(tmp_path / "first"), program.config)
    config, begin = replace(program.config, seed=9), tmp_path / "first" / "checkpoint.pt"
    program.fit(program.data, Run(tmp_path / "second"), config, begin)
    with pytest.raises(Killed):
        program.fit(program.data, KilledAt(tmp_path / "killed", config.validate_every + 1), config, begin)
    with pytest.raises(RunError, match="begun_from"):
        program.fit(program.data, Run(tmp_path / "killed"), config)
    program.fit(program.data, Run(tmp_path / "killed"), config, begin)
    second, killed = weights(tmp_path / "second"), weights(tmp_path / "killed")
    assert all(torch.equal(second[name], killed[name]) for name in second)
    saved = torch.load(tmp_path / "second" / "checkpoint.pt", weights_only=True)["config"]["begun_from"]
    assert saved.startswith(f"first at step {config.steps}, trained on sha256:")
    program.fit(program.data, Run(tmp_path / "random"), config)
    assert any(not torch.equal(second[name], other) for name, other in weights(tmp_path / "random").items())


def test_the_critic_changes_what_the_generator_learns(deformations: Path, tmp_path: Path) -> None:
    config = replace(SHORT, steps=6)  # the last step, at next to no rate, changes nothing that a float could hold
    fit_deformation(deformations, Run(tmp_path / "alone"), config)
    adversary = replace(tiny.adversary(ConditionConfig()), critic_steps=2)
    fit_deformation(deformations, Run(tmp_path / "against"), replace(config, adversary=adversary))
    alone, against = weights(tmp_path / "alone"), weights(tmp_path / "against")
    assert any(not torch.equal(alone[name], against[name]) for name in alone)
    critic = torch.load(tmp_path / "against" / "checkpoint.pt", weights_only=True)["critic"]
    assert critic["optimizer"]["state"][0]["step"] == 5 * 2  # from step 1 of 6, twice a step


def test_checkpoints_tell_code_and_data(deformations: Path, tmp_path: Path) -> None:
    fit_deformation(deformations, Run(tmp_path), replace(tiny.FIT_DEFORMATION, steps=3))
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert state["dataset"]["digest"] == Store(deformations).manifest()["digest"]
    assert state["code"] == code_version()


def test_curves_are_written_for_tensorboard(deformations: Path, tmp_path: Path) -> None:
    fit_deformation(deformations, Run(tmp_path, print_every=0.0), replace(tiny.FIT_DEFORMATION, steps=3))
    events = EventAccumulator(str(tmp_path)).Reload()
    tags = events.Tags()["scalars"]
    assert {"training/displacement", "training/kl", "validation/iou", "validation/active_latents"} <= set(tags)
    assert [event.step for event in events.Scalars("training/kl")] == [1, 2, 3]
    validated = events.Scalars("validation/iou")
    assert [(event.step, f"{event.value:.6f}") for event in validated] == [(3, log(tmp_path)[0]["iou"])]


def test_a_finished_run_is_left_as_it_is(program: Program, tmp_path: Path) -> None:
    config = dataclasses.replace(program.config, steps=3, validate_every=3)
    program.fit(program.data, Run(tmp_path), config)
    before = (tmp_path / "checkpoint.pt").read_bytes()
    program.fit(program.data, Run(tmp_path), config)
    assert (tmp_path / "checkpoint.pt").read_bytes() == before


def test_another_configuration_or_data_set_is_refused(program: Program, tmp_path: Path) -> None:
    config = dataclasses.replace(program.config, steps=3, validate_every=3)
    program.fit(program.data, Run(tmp_path / "run"), config)
    with pytest.raises(RunError, match="another optimizer"):
        other_rate = OptimizerConfig(learning_rate=1e-4)
        program.fit(program.data, Run(tmp_path / "run"), dataclasses.replace(config, optimizer=other_rate))
    # The same set with one body more.
    other = Store(tmp_path / "other")
    for index, group in Store(program.data).groups():
        other.write_group(index, group)
    other.write_group(6, dict(Store(program.data).groups())[5])
    other.write_manifest({})
    with pytest.raises(RunError, match="another data set"):
        program.fit(other.root, Run(tmp_path / "run"), config)


def test_an_unfinished_data_set_is_refused(program: Program, tmp_path: Path) -> None:
    store = Store(tmp_path / "unfinished")
    for index, group in Store(program.data).groups():
        store.write_group(index, group)
    with pytest.raises(StoreError, match="no manifest"):
        program.fit(store.root, Run(tmp_path / "run"), program.config)


def test_a_loss_that_is_no_number_stops_with_its_step_and_keeps_the_checkpoint(tmp_path: Path) -> None:
    data = tiny.write_deformations(tmp_path / "data")
    with pytest.raises(Killed):
        fit_deformation(data, KilledAt(tmp_path / "run", 4), tiny.FIT_DEFORMATION)
    before = (tmp_path / "run" / "checkpoint.pt").read_bytes()
    store = Store(data)
    for index, group in list(store.groups()):  # spoiled behind the manifest's back
        store.write_group(index, {**group, "forward": np.full_like(group["forward"], np.nan)})
    with pytest.raises(RunError, match=r"the loss is nan at step 3; the last checkpoint is kept"):
        fit_deformation(data, Run(tmp_path / "run"), tiny.FIT_DEFORMATION)
    assert (tmp_path / "run" / "checkpoint.pt").read_bytes() == before


def test_training_lowers_the_loss(deformations: Path, tmp_path: Path) -> None:
    """Twenty steps on three boxes: the field learns that things move along +x."""
    config = dataclasses.replace(
        tiny.FIT_DEFORMATION, steps=20, validate_every=20, optimizer=OptimizerConfig(learning_rate=2e-2, warm_up=2)
    )
    losses: list[float] = []

    class Watched(Run):
        def progress(self, done: int, total: int, first: int, started: float, losses_: dict[str, float]) -> None:
            losses.append(losses_["displacement"])

    fit_deformation(deformations, Watched(tmp_path), config)
    assert np.mean(losses[-4:]) < 0.8 * np.mean(losses[:4])
    assert set(log(tmp_path)[0]) == {
        "step", "iou", "identity", "skill", "active_latents", "displacement_error", "peak_ratio",
    }  # fmt: skip


def test_the_gain_starts_where_the_data_set_is(deformations: Path, tmp_path: Path) -> None:
    fit_deformation(deformations, Run(tmp_path), dataclasses.replace(tiny.FIT_DEFORMATION, steps=3))
    samples = DeformationSet.load(deformations, "train")
    expected = float(np.mean(np.log10(samples.peak) - samples.condition[:, 6]))
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["config"]["network"]["log_gain"]
    assert saved == pytest.approx(expected)


def test_the_right_correction_costs_only_the_blur_of_the_surface(deformations: Path) -> None:
    """With the truth in place of the network's answer nothing is left of the displacement term."""
    samples = DeformationSet.load(deformations, "train", prior=False)
    batch = samples.batch(np.arange(4))

    class Knowing(DeformationNetwork):
        """Says what `sheared` did: u grows with height, along x."""

        def __init__(self, scale: float) -> None:
            super().__init__(tiny.DEFORMATION)
            self.scale = scale

        def forward(self, rest, condition, noise, prior):
            latent = torch.zeros(len(condition), 3)
            height = (torch.arange(16) + 0.5) / 16
            shear = tiny.SHEAR * 10.0 ** condition[:, 6, None, None, None]
            moved = torch.zeros(len(condition), 3, 16, 16, 16)
            moved[:, 0] = self.scale * shear * height
            return moved, latent, latent

    config = dataclasses.replace(tiny.FIT_DEFORMATION, points=4096)
    right, _ = step_losses(Knowing(1.0), batch, config, np.random.default_rng(0))
    wrong, _ = step_losses(Knowing(-1.0), batch, config, np.random.default_rng(0))
    assert float(right["displacement"]) < 2e-2  # the lowest nodes of 32³ lie below those of 16³, which are held there
    assert float(right["kl"]) == 0.0
    assert float(right["occupancy"]) < 0.5 * float(wrong["occupancy"])


def test_voxels_are_compared_at_their_own_places_most_of_them_near_a_surface(deformations: Path) -> None:
    batch = DeformationSet.load(deformations, "train", prior=False).batch(np.array([0, 1]))
    points, target = sample_voxels(batch, 4000, np.random.default_rng(0))
    index = (points * 64 - 0.5).round().long()
    torch.testing.assert_close((index + 0.5) / 64, points, atol=1e-6, rtol=0)
    outer = torch.nn.functional.max_pool3d(batch.deformed[:, None], 3, 1, 1)[:, 0]
    inner = -torch.nn.functional.max_pool3d(-batch.deformed[:, None], 3, 1, 1)[:, 0]
    for i in range(2):
        x, y, z = index[i].T
        assert torch.equal(batch.deformed[i, x, y, z], target[i])
        band = (outer[i] != inner[i]) | (batch.deformed[i] != batch.rest[i, 0])
        assert float(band[x, y, z].float().mean()) > 0.75
    assert 0.25 < float(target.mean()) < 0.6


def test_augmentation_uses_all_eight_images_of_the_square(deformations: Path) -> None:
    batch = DeformationSet.load(deformations, "train").batch(np.array([0]))
    batch.rest[0, 0, 5, 20, 3] = 1.0  # a body without symmetry
    images = {
        augmented(batch, np.random.default_rng(seed)).rest.numpy().tobytes() for seed in range(60)
    }
    assert len(images) == 8


def test_validation_does_not_depend_on_chance(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "train")
    network = tiny.deformation_network()
    torch.manual_seed(1)
    first = validate(network, samples, 4)
    torch.manual_seed(2)
    assert validate(network, samples, 4) == first
