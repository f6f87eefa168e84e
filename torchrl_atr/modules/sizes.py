"""Sizes of networks, read from an env's specs."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import NestedKey
from torchrl.data import Composite, TensorSpec

from torchrl_atr._checks import check_keys, check_kind, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.modules.estimators import EstimatorSpec, Role
from torchrl_atr.modules.keys import NetworkKeys


def entry(spec: TensorSpec, key: NestedKey) -> TensorSpec:
    """Return ``spec[key]``, or ``spec`` itself if it is a leaf.

    Raises:
        KeyError: if there is no such entry; names the nearest one.
    """
    check_kind("spec", spec, TensorSpec, "a spec of the env's")
    if not isinstance(spec, Composite):
        return spec
    if key not in spec.keys(True, True):
        entries = f"it has {', '.join(map(str, spec.keys()))}."
        similar = nearest(str(key), map(str, spec.keys(True, True)), otherwise=entries)
        raise KeyError(
            f"The spec has no entry {key!r}; {similar} Add the transform that writes it, or pass "
            "keys=NetworkKeys(...) with the env's own names."
        )
    return spec[key]


def entry_shape(spec: TensorSpec, key: NestedKey, ndim: int) -> tuple[int, ...]:
    """Return the last ``ndim`` sizes of ``spec[key]`` (of ``spec`` itself if it is a leaf).

    Args:
        spec (TensorSpec): of an env.
        key (NestedKey): of the entry.
        ndim (int): dimensions of one robot's entry.

    Raises:
        KeyError: if there is no such entry. ValueError: if it has fewer dimensions.

    Example:
        >>> from torchrl.data import Unbounded
        >>> entry_shape(Composite(history=Unbounded((8, 4, 5))), "history", 2)
        (4, 5)
    """
    spec = entry(spec, key)
    if len(spec.shape) < ndim:
        raise ValueError(f"The spec of {key!r} needs at least {ndim} dimension(s), got {tuple(spec.shape)}.")
    return tuple(spec.shape[-ndim:])


def input_sizes(spec: Composite, argument: str, inputs: Sequence[NestedKey]) -> list[int]:
    """Return the sizes of the entries named by an argument.

    Args:
        spec (Composite): of an env.
        argument (str): its name, for messages.
        inputs (sequence of NestedKey): its value.

    Raises:
        InputError: if the value is not a list of keys.
        KeyError: if the spec has no such entry.

    Example:
        >>> from torchrl.data import Unbounded
        >>> input_sizes(Composite(wind=Unbounded((8, 3))), "estimator_inputs", ["wind"])
        [3]
    """
    available = spec.keys(True, True)
    for key in check_keys(argument, inputs):
        if key not in available:
            raise KeyError(
                f"{argument} names {key!r}, which the spec lacks; it has {', '.join(map(str, spec.keys()))}. Leave it "
                "out, or add the transform that writes it."
            )
    return [entry_shape(spec, key, 1)[0] for key in inputs]


def estimator_specs(
    observation_spec: Composite,
    latent_features: int = 16,
    keys: NetworkKeys | None = None,
    estimator_inputs: Sequence[NestedKey] = (),
    shared: bool = False,
    actor_reads: Sequence[str] = ("latent", "extrinsic"),
) -> dict[Role, EstimatorSpec]:
    """Return what each estimator is told, by its role, from an env's specs.

    Args:
        observation_spec (Composite): see :func:`make_networks`.
        latent_features (int): size of z. Defaults to 16.
        keys (NetworkKeys, optional): names of the entries, if the env has its own.
        estimator_inputs (sequence of NestedKey): further inputs of the one of the extrinsic state. Defaults to none.
        shared (bool): whether one estimator has both roles. Defaults to False.
        actor_reads (sequence of str): what there are estimators of: ``latent``, ``extrinsic``. Defaults to both.

    Raises:
        KeyError: if the spec lacks an entry.
        InputError: if further inputs, or both roles, are asked of an estimator that the actor does not read.

    Example:
        >>> from torchrl.data import Composite, Unbounded
        >>> spec = Composite(
        ...     observation=Unbounded((5,)),
        ...     history=Unbounded((4, 5)),
        ...     privileged=Composite(extrinsic=Unbounded((3,))),
        ... )
        >>> {role: (each.window_shape, each.out_features) for role, each in estimator_specs(spec).items()}
        {'intrinsic': ((4, 5), 16), 'extrinsic': ((4, 5), 3)}
    """
    keys = keys or NetworkKeys()
    length, features = entry_shape(observation_spec, keys.history, 2)
    (extrinsic,) = entry_shape(observation_spec, keys.extrinsic, 1)
    inputs = dict(zip(estimator_inputs, input_sizes(observation_spec, "estimator_inputs", estimator_inputs)))
    sizes, window = {"intrinsic": latent_features, "extrinsic": extrinsic}, (length, features)
    lacking = {"latent", "extrinsic"}.difference(actor_reads)
    for asked, what in ((inputs and lacking & {"extrinsic"}, "estimator_inputs"), (shared and lacking, "shared=True")):
        if asked:
            raise InputError(
                f"{what}: actor_reads={list(actor_reads)} lacks {' and '.join(sorted(asked))}, so there is no "
                "estimator of it; leave it out, or add it there"
            )
    if shared:
        return {"both": EstimatorSpec("both", window, sizes, inputs, keys)}
    specs: dict[Role, EstimatorSpec] = {}
    if "latent" not in lacking:
        specs["intrinsic"] = EstimatorSpec("intrinsic", window, {"intrinsic": latent_features}, {}, keys)
    if "extrinsic" not in lacking:
        specs["extrinsic"] = EstimatorSpec("extrinsic", window, {"extrinsic": extrinsic}, inputs, keys)
    return specs


def check_widths(**cells: Sequence[int]) -> None:
    """Check hidden widths, by the arguments' names.

    Raises:
        InputError: for a value that is not a list of whole numbers, 1 or more.

    Example:
        >>> check_widths(actor_cells=(512, 256))
    """
    for name, widths in cells.items():
        for width in check_kind(name, widths, (list, tuple), "a list of widths"):
            check_whole(name, width, low=1)
