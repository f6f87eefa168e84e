"""Writer of policy bundles, which checks ONNX Runtime against torch before it ends."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchrl_atr._errors import MissingPackageError, UserError
from torchrl_atr._files import write_json
from torchrl_atr.deploy.card import card, check_scorecard, figures
from torchrl_atr.deploy.description import describe_policy
from torchrl_atr.deploy.episode import record
from torchrl_atr.deploy.loading import load_policy
from torchrl_atr.deploy.manifest import CARD, EPISODE, MANIFEST, POLICY, SCENE, is_bundle, is_whole_bundle, seal, sha256
from torchrl_atr.deploy.parity import Parity, verify
from torchrl_atr.deploy.policy_step import MEMORY, PolicyStep, StepOutput
from torchrl_atr.deploy.reports import copy_reports
from torchrl_atr.deploy.weights import write_weights
from torchrl_atr.envs.models import scene_xml
from torchrl_atr.envs.transforms import FootRepositioning
from torchrl_atr.runs.files import MODEL
from torchrl_atr.training import commanded_range, load_run

LARGEST = 2_000_000
"""Largest size of a bundle without pictures, bytes."""
OPSET = 20
_BATCH = 2
"""Robots of the example that is traced; of one, the batch would be taken as fixed."""


def export_run(
    run: str | Path, output: str | Path, imports: Sequence[str] = (), checkpoint: str | None = None
) -> Parity:
    """Write the deployed policy of a run as a bundle, whole or not at all.

    Args:
        run: its folder.
        output: folder of the bundle, whose name becomes the policy's; a bundle that is there is replaced.
        imports: modules to import besides those that the run remembers.
        checkpoint: a file of the run, such as ``best.pt``; None for the last one.

    Returns:
        The comparison of ONNX Runtime with torch.

    Raises:
        UserError: if the folder is taken, the policy reads what the runtime does not know, the run's scorecard is of
            another training, the bundle is too large, or ONNX Runtime acts otherwise than torch.
        MissingPackageError: if a package of the extra ``deploy`` is not installed.
    """
    run, output = Path(run), Path(output).resolve()
    if is_bundle(run):
        raise UserError(f"{run} is a bundle already; copy its folder, or give the run that it was exported from")
    if output.is_file() or (output.exists() and any(output.iterdir()) and not is_whole_bundle(output)):
        raise UserError(f"{output} holds something else than a bundle; give the path of a new folder")
    staged, before = (output.with_name(f".{output.name}.{os.getpid()}.{kind}") for kind in ("part", "old"))
    try:
        staged.mkdir(parents=True)
        parity = _write(run, staged, output.name, imports, checkpoint)
        if output.exists():
            os.replace(output, before)
        os.replace(staged, output)
    finally:
        if before.exists() and not output.exists():  # interrupted between the two
            os.replace(before, output)
        for left in (staged, before):
            shutil.rmtree(left, ignore_errors=True)
    return parity


def _write(run: Path, folder: Path, name: str, imports: Sequence[str], checkpoint: str | None) -> Parity:
    config, env, networks, state = load_run(run, checkpoint, imports, num_envs=_BATCH)
    with closing(env):
        check_scorecard(run, state["provenance"])
        networks.deployed_policy()  # a teacher has none
        base = env.base_env
        limits = commanded_range(config, networks)
        if limits is None:
            raise UserError(f"a policy of the task {base.task.name!r}, without a range of commands, cannot be exported")
        steps: Any = next((each.steps for each in env.transform if isinstance(each, FootRepositioning)), None)
        step = PolicyStep(networks, base.task, base.scene, limits, config.curriculum.slew_rates, steps).eval()
        manifest = describe_policy(config, base, limits, networks.command_range is not None, state["provenance"])
        manifest = {"name": name, **manifest, "policy": _write_onnx(step, env, folder), "figures": figures(run)}
        _write_scene(base, folder)
    limits.save(folder)
    write_weights(folder, state)
    if (run / MODEL).is_dir():
        shutil.copytree(run / MODEL, folder / MODEL)
    copy_reports(run, folder, state["provenance"])
    _seal(folder, manifest)  # the policy is loaded from the bundle itself: its weights are compared, too
    episode: dict[str, Any] = record(load_policy(folder, imports))
    np.savez_compressed(folder / EPISODE, **episode)
    _seal(folder, manifest)
    parity = verify(folder)
    manifest["parity"] = parity._asdict()
    (folder / CARD).write_text(card(run, manifest), encoding="utf-8")
    _seal(folder, manifest)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    if size > LARGEST:
        raise UserError(
            f"the bundle of {run} has {size / 1e6:.2f} MB, more than {LARGEST / 1e6:g}; train smaller networks"
        )
    return parity


def _seal(folder: Path, manifest: dict[str, Any]) -> None:
    files = sorted(file for file in folder.rglob("*") if file.is_file() and file.name != MANIFEST)
    hashes = {file.relative_to(folder).as_posix(): sha256(file) for file in files}
    write_json(folder / MANIFEST, seal(json.loads(json.dumps({**manifest, "files": hashes}, allow_nan=False))))


def _write_onnx(step: PolicyStep, env: Any, folder: Path) -> dict[str, Any]:
    """Export a policy's step, and return its names and sizes for the manifest."""
    example = _example(step, env)
    shapes = {name: tuple(value.shape[1:]) for name, value in example.items()}
    with torch.no_grad(), _quiet():
        try:
            program = torch.onnx.export(
                step,
                tuple(example.values()),
                dynamo=True,
                input_names=list(step.inputs),
                output_names=list(StepOutput._fields),
                dynamic_shapes=({0: torch.export.Dim("batch")},) * len(step.inputs),
                opset_version=OPSET,
                verbose=False,
            )
        except ImportError as error:
            raise MissingPackageError("onnx" if error.name is None else error.name, "deploy") from error
    assert program is not None
    model = program.model_proto
    for node in model.graph.node:  # traces of the source code
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*model.graph.input, *model.graph.output, *model.graph.initializer):
        del value.metadata_props[:]
    del model.graph.value_info[:]  # shapes between nodes, which a runtime infers
    (folder / POLICY).write_bytes(model.SerializeToString())
    return {
        "opset": model.opset_import[0].version,
        "producer": f"{model.producer_name} {model.producer_version}",
        "inputs": {name: list(shapes[name]) for name in step.inputs},
        "outputs": {name: list(value.shape[1:]) for name, value in zip(StepOutput._fields, step(*example.values()))},
        "state": [
            {"input": name, "output": output, "shape": list(shapes[name]), "start": "any: start=true sets it"}
            for name, output in step.state.items()
        ],
        "batch": "every tensor has the number of robots, one or more, as its first dimension",
    }


@contextmanager
def _quiet() -> Iterator[None]:
    """Leave out what torch's exporter says about itself."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _example(step: PolicyStep, env: Any) -> dict[str, torch.Tensor]:
    """Return inputs of a step by name, robots standing."""
    first, sizes = env.reset(), env.base_env.runner.terms.observations.sizes["proprio"]
    parts = dict(zip(sizes, first["proprio"].split(list(sizes.values()), -1)))
    given = {
        **parts,
        "start": torch.tensor([[True], [False]]),
        "command": first["command"],
        "history": first["history"],
        "dead_reckoning": step.rest.expand(_BATCH, -1),
        "last_action": parts["action"],
        "last_command": first["command"],
        MEMORY: step.memory(_BATCH),
    }
    return {name: given[name].clone() for name in step.inputs}


def _write_scene(base: Any, folder: Path) -> None:
    xml = scene_xml(base.scene.robot, base.scene.support)
    if " file=" not in xml:  # of a mesh, which the bundle does not hold
        xml = re.sub(r' (meshdir|texturedir)="[^"]*"', "", xml)  # folders of this machine
        (folder / SCENE).write_text(xml, encoding="utf-8")
