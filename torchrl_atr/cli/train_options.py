"""Command line of ``torchrl-atr train``: every setting by its dotted name, parsed by tyro, and paths."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import io
import typing
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from torchrl_atr._settings import ConfigError, Setting, settings
from torchrl_atr.config.nested import suggestion
from torchrl_atr.deploy.manifest import find_policy
from torchrl_atr.training import TrainConfig, parse_settings

DEFAULT_RUN = Path("runs/latest")
RESUMABLE = ("total_frames", "max_minutes", "compute.device", "imports")
"""Settings that a resumed run may change."""
_PATHS = {
    "config": "File with any settings, .toml or .json, such as a run's config.toml.",
    "output": f"The run folder (default: {DEFAULT_RUN}).",
    "resume": "Continue this run as if it had not stopped.",
    "start": "Begin a new run with this one's (or a policy's) networks, optimisers, command grid and settings, but "
    "for those given.",
}
_DESCRIPTION = """Train a policy. Of a setting's sources the later wins: its default, the preset's, the task's, the
file's (--config) or the other run's (--from, then --config), the command line's. A reward weight is
--task.rewards.TERM WEIGHT, a range --task.randomization.PARAMETER.train LOW,HIGH (or .test), an estimator's argument
--estimator.arguments.NAME VALUE. `torchrl-atr list settings` says what each setting is for."""


@dataclass(frozen=True)
class TrainArguments:
    """Parsed command line.

    Attributes:
        given: settings by dotted name.
        config, output, resume, start: paths, None where not given; ``start`` is that of ``--from``.
        overwrite: whether a run in ``output`` is replaced.
    """

    given: dict[str, Any] = field(default_factory=dict)
    config: Path | None = None
    output: Path | None = None
    resume: Path | None = None
    start: Path | None = None
    overwrite: bool = False


def option(path: str) -> str:
    """Return the name of a setting on the command line.

    Example:
        >>> option("env.num_envs"), option("ppo.clip_epsilon"), option("imports")
        ('--num-envs', '--ppo.clip-epsilon', '--import')
    """
    known = settings(TrainConfig)
    short = known[path].alias if path in known else ""
    return f"--{ {'imports': 'import', 'start': 'from'}.get(path) or short or path.replace('_', '-') }"


def parse_train(words: Sequence[str]) -> TrainArguments:
    """Parse the words after ``torchrl-atr train``; ``--help`` prints and ends the process.

    Raises:
        ConfigError: for an unknown word, an option without a value, or an empty path.

    Example:
        >>> parse_train(["--num-envs", "64", "--task.rewards.heading-alignment", "-2"]).given
        {'task.rewards.heading_alignment': -2.0, 'env.num_envs': 64.0}
    """
    texts, rest = _entries(list(words))
    parsed = _parsed(rest)
    for path in settings(TrainConfig):
        value = parsed
        for name in path.split("."):
            value = getattr(value, name, None)
        if value is not None and path != "imports":
            texts[path] = value
    given = parse_settings(texts) | ({"imports": list(parsed.imports)} if parsed.imports else {})
    paths: dict[str, Any] = {name: _path(name, getattr(parsed, name)) for name in _PATHS}
    return TrainArguments(given, **paths, overwrite=parsed.overwrite)


def _path(name: str, text: str | None) -> Path | None:
    if text is None:
        return None
    if not text.strip():  # from an unset shell variable; Path("") would be the working directory
        raise ConfigError(f"{option(name)}: it is empty; give a path")
    path = Path(text)
    if name in ("resume", "start") and path.is_file():
        raise ConfigError(f"{option(name)}: {path} is a file; give the folder of a run, such as {path.parent}")
    return find_policy(path) if name in ("resume", "start") else path  # a bundle is refused by name, too


def _entries(words: list[str]) -> tuple[dict[str, str], list[str]]:
    """Return the entries of settings that are mappings, whose names only the task knows, and the other words."""
    mappings = [path for path, each in settings(TrainConfig).items() if typing.get_origin(each.kind) is dict]
    texts, rest = {}, []
    while words:
        word = words.pop(0)
        name, separator, value = word.removeprefix("--").partition("=")
        path = name.replace("-", "_")
        if not word.startswith("--") or not any(path.startswith(f"{mapping}.") for mapping in mappings):
            rest.append(word)
        elif separator or words:
            texts[path] = value if separator else words.pop(0)
        else:
            raise ConfigError(f"--{name} needs a value, such as --{name} 1.0")
    return texts, rest


def _parsed(words: list[str]) -> Any:
    """Return an instance of :func:`_options`."""
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            parsed, unknown = tyro.cli(  # type: ignore[var-annotated]  # of a type made here
                _options(), prog="torchrl-atr train", description=_DESCRIPTION, args=words, return_unknown_args=True
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        box = "│╭╮╰╯─ "  # blanks and dashes where the terminal's encoding has none of these
        lines = [line.strip(box) for line in errors.getvalue().splitlines() if line.strip(box + "-")]
        raise ConfigError(f"{' '.join(lines[1:2]) or 'this cannot be parsed.'} See torchrl-atr train --help") from None
    if unknown:
        raise ConfigError(f"unknown argument {unknown[0]!r}; {_hint(unknown[0])}")
    return parsed


def _hint(word: str) -> str:
    """Return a hint at the option that was meant."""
    name = word.partition("=")[0].lstrip("-").replace("-", "_")
    known = settings(TrainConfig)
    if name in known:  # a mapping
        return f"write --{name.replace('_', '-')}.NAME VALUE"
    short = [
        "config",
        "output",
        "resume",
        "from",
        "overwrite",
        "import",
        *(each.alias.replace("-", "_") for each in known.values() if each.alias),
    ]
    if close := difflib.get_close_matches(name, short, 1, 0.7):
        return f"did you mean '--{close[0].replace('_', '-')}'?"
    return suggestion(TrainConfig, name, lambda path: option(path))


def _options() -> type:
    """Return a dataclass whose fields are all settings, as texts; None marks those that are not given."""
    tree: dict[str, Any] = {}
    for path, each in settings(TrainConfig).items():
        *groups, name = path.split(".")
        if typing.get_origin(each.kind) is dict:
            continue
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = _leaf(each)
    tree |= {name: _text(text, "PATH", name=option(name)[2:]) for name, text in _PATHS.items()}
    overwrite = tyro.conf.arg(help="Replace a run in that folder.", help_behavior_hint="")
    tree["overwrite"] = Annotated[tyro.conf.FlagCreatePairsOff[bool], overwrite], False
    return _dataclass("Train", tree)


def _leaf(each: Setting) -> tuple[Any, Any]:
    if each.path == "imports":
        kind = tyro.conf.UseAppendAction[tuple[str, ...]]
        return Annotated[kind, tyro.conf.arg(name="import", metavar="MODULE", help=each.text)], ()
    metavar = {int: "INT", float: "NUMBER", bool: "{true,false}", str: "NAME"}.get(each.kind, "A,B")
    if typing.get_origin(each.kind) is typing.Literal:
        metavar = f"{{{','.join(typing.get_args(each.kind))}}}"
    alias = (f"--{each.alias}",) if "." in each.path and each.alias else ()
    limits = f", {each.range}" if each.within else ""
    return _text(f"{each.text} (default: {each.default}{limits})", metavar, aliases=alias)


def _text(help: str, metavar: str, **more: Any) -> tuple[Any, Any]:
    return Annotated[str | None, tyro.conf.arg(help=help, metavar=metavar, help_behavior_hint="", **more)], None


def _dataclass(name: str, tree: dict[str, Any]) -> type:
    kinds = {key: _dataclass(key, value) for key, value in tree.items() if isinstance(value, dict)}
    fields = [
        (key, kinds[key], field(default_factory=kinds[key])) if key in kinds else (key, *tree[key]) for key in tree
    ]
    return dataclasses.make_dataclass(name, fields)
