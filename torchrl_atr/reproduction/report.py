"""Report of a figure or table of the paper: its JSON file, its page, and the claims that it tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from torchrl_atr._files import atomic, write_json
from torchrl_atr._text import markdown_table
from torchrl_atr.reproduction.parts import Parts
from torchrl_atr.reproduction.policies import RiderPolicy
from torchrl_atr.runs.provenance import cores, machine

HOLDS, FAILS, UNKNOWN = "holds", "does not hold here", "cannot be told"
"""Verdicts on a claim."""
Progress = Callable[[int, int], None]


def _silent(what: str) -> AbstractContextManager[Progress]:
    return nullcontext(lambda done, total: None)


@dataclass
class Job:
    """Request for a reproduction.

    Attributes:
        policies: that ride, one for each pair.
        parts: finished measurements.
        command: that makes the same again, for the report.
        seed: of all measurements.
        quick: whether sizes are coarse: it shows that everything works, and measures little.
        imports: modules that policies need.
        progress: ``with progress("what") as told: told(steps done, steps in total)``.
    """

    policies: Sequence[RiderPolicy]
    parts: Parts
    command: str = ""
    seed: int = 0
    quick: bool = False
    imports: Sequence[str] = ()
    progress: Callable[[str], AbstractContextManager[Progress]] = _silent
    begun: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Claim:
    """Claim of the paper and its test.

    Attributes:
        text: what the paper says.
        test: what was measured, and when the claim holds.
        value: the figure; None if it could not be measured.
        interval: 95 %, None for less than two samples.
        verdict: :data:`HOLDS`, :data:`FAILS` or :data:`UNKNOWN`.
        remark: what is missing, or how to read it.
    """

    text: str
    test: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    verdict: str = UNKNOWN
    remark: str = ""


def judge(interval: tuple[float, float] | None, bound: float = 0.0) -> str:
    """Return the verdict on "the figure is above ``bound``", from its interval.

    Example:
        >>> judge((0.1, 0.3)), judge((-0.3, -0.1)), judge((-0.1, 0.1)), judge(None)
        ('holds', 'does not hold here', 'cannot be told', 'cannot be told')
    """
    if interval is None:
        return UNKNOWN
    return HOLDS if interval[0] > bound else FAILS if interval[1] < bound else UNKNOWN


def write_report(
    job: Job, folder: Path, name: str, title: str, sections: Iterable[str], claims: Sequence[Claim], **data: Any
) -> Path:
    """Write ``NAME.json`` and ``README.md``; return the page.

    Args:
        job: that was done.
        folder: to write to.
        name: such as ``figure4``.
        title: of the page.
        sections: Markdown paragraphs, tables and images between the title and the claims.
        claims: of the paper that were tested.
        **data: further entries of the JSON file.

    Raises:
        ValueError: if ``data`` holds NaN or infinity, which JSON cannot.
    """
    made = provenance(job)
    values = {"name": name, "title": title, "claims": [asdict(claim) for claim in claims], **data, "made": made}
    write_json(folder / f"{name}.json", values, allow_nan=False)
    page = [f"# {title}", made_by(made), *sections]
    if claims:
        page += ["## Claims of the paper", claim_table(values["claims"])]
    path = folder / "README.md"
    with atomic(path) as file:
        file.write_text("\n\n".join(page) + "\n", encoding="utf-8")
    return path


def provenance(job: Job) -> dict[str, Any]:
    """Return how a report was made: command, seed, machine, versions, seconds, policies.

    The seconds are those of all measurements in it, those that were made in earlier sessions included.
    """
    return {
        "command": job.command,
        "seed": job.seed,
        "quick": job.quick,
        **machine(),
        "seconds": round(max(sum(job.parts.seconds.values()), time.monotonic() - job.begun), 1),
        "policies": {policy.name: policy.described() for policy in job.policies},
    }


def made_by(made: Mapping[str, Any]) -> str:
    """Return the paragraph on how a report was made."""
    version = made["versions"].get("commit") or made["versions"]["torchrl_atr"]
    coarse = " **Coarse sizes: it shows that everything works and measures little.**" if made["quick"] else ""
    lines = [
        f"`{made['command']}`, seed {made['seed']}, version {version}, {made['seconds'] / 60:.1f} minutes on "
        f"{cores(made['hardware'])}. Brackets are 95 % intervals.{coarse}"
    ]
    for name, policy in made["policies"].items():
        frames = "" if policy["frames"] is None else f", {policy['frames']:,} robot steps"
        lines.append(f"- {name}: `{policy['folder']}`{frames}")
    return "\n".join(lines[:1]) + ("\n\n" + "\n".join(lines[1:]) if lines[1:] else "")


def claim_table(claims: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of claims, their tests, figures and verdicts."""
    rows = [
        [
            claim["text"],
            claim["test"],
            with_interval(claim["value"], claim["interval"]),
            ". ".join(filter(None, [f"**{claim['verdict']}**", claim["remark"]])),
        ]
        for claim in claims
    ]
    return markdown_table(["claim", "test", "here", "verdict"], rows)


def with_interval(value: float | None, interval: Sequence[float] | None = None, decimals: int = 3) -> str:
    """Return a figure with its interval as text.

    Example:
        >>> with_interval(0.5, (0.25, 0.75), 2), with_interval(0.5), with_interval(None)
        ('0.50 [0.25, 0.75]', '0.500', 'not measured')
    """
    if value is None:
        return "not measured"
    text = f"{value:.{decimals}f}"
    return text if interval is None else f"{text} [{', '.join(f'{end:.{decimals}f}' for end in interval)}]"


def missing_pairs(present: Iterable[str], pairs: Iterable[str]) -> str:
    """Return the sentence on pairs without a policy; empty if all are there.

    Example:
        >>> missing_pairs(["a"], ["a", "b"])
        'Missing, as no policy was given: b.'
    """
    missing = [pair for pair in pairs if pair not in set(present)]
    return f"Missing, as no policy was given: {', '.join(missing)}." if missing else ""
