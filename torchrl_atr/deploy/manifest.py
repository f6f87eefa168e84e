"""Policy bundles: where they are, and their manifest, read and checked; without torch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from torchrl_atr._errors import UserError

SCHEMA, VERSION = "torchrl_atr.policy_bundle", 2
"""Schema of a manifest, and its version; a change of names or meanings raises the latter."""
MANIFEST, POLICY, WEIGHTS, EPISODE, SCENE, CARD = (
    "manifest.json",
    "policy.onnx",
    "weights.safetensors",
    "episode.npz",
    "scene.xml",
    "README.md",
)
"""Files of a bundle; ``scene.xml`` is missing if the robot has meshes."""
_EXPORT = "export it anew with `torchrl-atr export RUN --output DIR`"


class BundleError(UserError, RuntimeError):
    """Error of a policy bundle that is incomplete, changed, or of another version; the message names the remedy."""


def policies() -> dict[str, Path]:
    """Return the folders of the policies that are installed with the package, by name.

    Example:
        >>> all((folder / MANIFEST).is_file() for folder in policies().values())
        True
    """
    root = resources.files("torchrl_atr") / "policies"
    if not isinstance(root, Path) or not root.is_dir():  # an archive: ONNX Runtime and MuJoCo need files
        return {}
    return {folder.name: folder for folder in sorted(root.iterdir()) if is_bundle(folder)}


def find_policy(run: str | Path) -> Path:
    """Return the folder of a run or a bundle: the path itself, or an installed policy if it is the name of one.

    A path that exists wins; one that does not is returned as it is.

    Example:
        >>> find_policy("runs/ride").as_posix()
        'runs/ride'
    """
    path = Path(run)
    return path if path.exists() else policies().get(str(run), path)


def report_home(run: Path) -> Path:
    """Return the folder for reports about a run: itself; for a bundle, whose files are sealed, ``runs/policies/NAME``.

    Example:
        >>> report_home(Path("runs/ride")).as_posix()
        'runs/ride'
    """
    return Path("runs", "policies", run.resolve().name) if is_bundle(run) else run


def is_bundle(folder: Path) -> bool:
    """Return whether a folder holds a manifest."""
    return (folder / MANIFEST).is_file()


def is_whole_bundle(folder: Path) -> bool:
    """Return whether a folder holds a bundle of any version, and no other file: it may be replaced."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        return False
    held = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    return held <= {MANIFEST, *manifest.get("files", ())}


def ground_of(manifest: Mapping[str, Any]) -> str:
    """Return the name of what a bundle's robot stands on."""
    return "the floor" if manifest["transporter"] is None else str(manifest["transporter"]["name"])


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def seal(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with the SHA-256 of all of its other values.

    Example:
        >>> seal({"version": 1})["sha256"][:8]
        'c3aa9744'
    """
    values = {name: value for name, value in manifest.items() if name != "sha256"}
    return {**values, "sha256": hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()}


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """Read the manifest of a bundle, and check it and all files of the bundle.

    Args:
        folder: of the bundle, or the name of an installed policy.

    Raises:
        BundleError: if the folder is no bundle, is of another schema or version, or a file is missing or changed.
    """
    folder = find_policy(folder)
    path = folder / MANIFEST
    if not path.is_file():
        known = ", ".join(policies()) or "none is installed"
        raise BundleError(
            f"there is no policy bundle at {folder}: {MANIFEST} is missing; give a folder that `torchrl-atr export` "
            f"wrote, or the name of an installed policy ({known})"
        )
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BundleError(f"{path} is not JSON ({error}); copy the bundle again, or {_EXPORT}") from None
    _check_version(manifest, path)
    if seal(manifest) != manifest:
        raise BundleError(f"{path} was changed after the export; copy the bundle again, or {_EXPORT}")
    for name, digest in manifest["files"].items():
        if not (folder / name).is_file():
            raise BundleError(f"the bundle {folder} lacks {name}; copy the whole folder, or {_EXPORT}")
        if sha256(folder / name) != digest:
            raise BundleError(
                f"{name} of the bundle {folder} is not the file that was exported (its SHA-256 differs); copy the "
                f"bundle again, or {_EXPORT}"
            )
    return manifest


def _check_version(manifest: Any, path: Path) -> None:
    schema, version = (manifest.get(name) if isinstance(manifest, dict) else None for name in ("schema", "version"))
    if schema != SCHEMA:
        raise BundleError(
            f"{path} has schema {schema!r}, not {SCHEMA!r}; give a folder that `torchrl-atr export` wrote"
        )
    if version != VERSION:
        writer = manifest.get("versions", {}).get("torchrl_atr", "unknown")
        raise BundleError(
            f"{path} has version {version!r}; this code reads version {VERSION}: use the torchrl_atr that wrote it "
            f"({writer}), or {_EXPORT}"
        )
