"""Actor of Table I (pi^a): its backbone, and the policies made from it and an exploration."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from torchrl_atr.modules.action_noise import RotatedNormal
from torchrl_atr.modules.exploration import Exploration
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.symmetry import check_reflection, halves_swapped, join_reflections, make_mlp

INPUT_GAIN = 4.0
"""Factor of product and error inputs: Adam's steps are alike for all weights, so a larger input is learned faster."""
HISTORY_FEATURES = 16
"""Units that each past observation is embedded in, by one layer shared over time."""
ERROR_SCALE = 0.5
"""Error at which an error input is tanh(1), in the units of the command; that of the tracking rewards' kernel."""


class ActorBackbone(nn.Module):
    """Network from observation, latent and extrinsic state to the mean action (Table I, pi^a).

    The observation and the extrinsic state are normalised inside; the latent is not (it has the encoder's
    scale). Exploration is not part of it: see :class:`~torchrl_atr.modules.Exploration`.

    Args:
        observation_norm (RunningNormalizer): shared with critic and estimators.
        extrinsic_norm (RunningNormalizer, optional): the same; None for an actor that reads no extrinsic state.
        latent_features (int): size of the latent, L; 0 for an actor that reads none.
        action_features (int): number of actions, A.
        cells (sequence of int): hidden widths. Defaults to ``(512, 256, 128)``.
        input_products (sequence of pairs of int): for every ``(i, j)`` the network also reads ``tanh(x_i) * x_j`` of
            the normalised observation x, times :data:`INPUT_GAIN`. A board turns by the product of two tilts, so
            the lean for a yaw command changes sign with the speed command: an exclusive-or, which has no
            gradient at first. Indices from O on are those of the errors below.
        input_errors (sequence of pairs of int): for every ``(i, j)`` the network also reads
            ``tanh((s_j - o_i) / 0.5)`` of observation o and extrinsic state s in SI units, times :data:`INPUT_GAIN`:
            how far component j is from the command in component i.
        reflection (Tensor, optional): of the action, (A, A). The mean action of a mirrored robot is then the mirrored
            mean action; both normalisers need a reflection, and the latent's is a swap of its halves, as
            :class:`~torchrl_atr.modules.IntrinsicEncoder` makes it.
        output_map (Tensor, optional): M, (A, A), invertible and fixed: the mean action is ``y @ M`` for the outputs y
            of the last layer, so row i is the direction, in units of the action, in which output i moves it, and its
            length is that output's gain. It decides how fast a direction is learned, since Adam's steps are alike in
            all outputs. None, the default, is the identity.
        reads_scale (bool): whether it also reads the standard deviations of latent and extrinsic state. Defaults to
            False.
        history_length (int): H, past observations that it reads, each through one layer of
            :data:`HISTORY_FEATURES` units. Defaults to 0.

    Attributes:
        reads (tuple of str): what it reads beside the observation, in order: ``history``, ``latent``, ``extrinsic``,
            ``latent_scale`` and ``extrinsic_scale``, or some of these.

    Raises:
        ValueError: for a product or an error of entries that do not exist, for an output map of another size or
            without an inverse, and for an invalid reflection, or one that does not map each product and error, and each
            row of the output map, to plus or minus one of them.

    Example:
        >>> import torch
        >>> backbone = ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2)
        >>> backbone(torch.zeros(7, 5), torch.zeros(7, 3), torch.zeros(7, 4)).shape
        torch.Size([7, 2])
    """

    _gates: Tensor
    _gated: Tensor
    _commanded: Tensor
    _followed: Tensor
    output_map: Tensor | None

    def __init__(
        self,
        observation_norm: RunningNormalizer,
        extrinsic_norm: RunningNormalizer | None,
        latent_features: int,
        action_features: int,
        *,
        cells: Sequence[int] = (512, 256, 128),
        input_products: Sequence[tuple[int, int]] = (),
        input_errors: Sequence[tuple[int, int]] = (),
        reflection: Tensor | None = None,
        output_map: Tensor | None = None,
        reads_scale: bool = False,
        history_length: int = 0,
    ) -> None:
        super().__init__()
        size, states = observation_norm.shape.numel(), 0 if extrinsic_norm is None else extrinsic_norm.shape.numel()
        _check_pairs("input_errors", input_errors, size, states)
        _check_pairs("input_products", input_products, *[size + len(input_errors)] * 2)
        for names, chosen in (("_gates", "_gated"), input_products), (("_commanded", "_followed"), input_errors):
            pairs = torch.tensor(chosen, dtype=torch.long).reshape(-1, 2)
            for name, indices in zip(names, pairs.T):  # buffers are on the device: lists would be copied there
                self.register_buffer(name, indices.contiguous(), persistent=False)
        output_map = None if output_map is None else _check_output_map(output_map, action_features)
        self.register_buffer("output_map", output_map)
        self.observation_norm = observation_norm
        self.extrinsic_norm = extrinsic_norm
        estimated = {name: width for name, width in (("latent", latent_features), ("extrinsic", states)) if width}
        scales = {f"{name}_scale": width for name, width in estimated.items() if reads_scale}
        history = {"history": history_length * HISTORY_FEATURES} if history_length else {}
        widths = {**history, **estimated, **scales}
        self.reads = tuple(widths)
        in_features = size + len(input_errors) + len(input_products) + sum(widths.values())
        reflections = None
        if reflection is not None:
            mirror = check_reflection(reflection, action_features, "the action's reflection")
            mirror = mirror if output_map is None else _output_reflection(mirror, output_map)
            reflections = self._input_reflection(latent_features, history_length), mirror
        if history_length:
            embedded = halves_swapped(HISTORY_FEATURES)
            sides = None if reflection is None else (join_reflections(observation_norm.reflection), embedded)
            self.history_net = make_mlp(size, HISTORY_FEATURES, (), sides)
        self.net = make_mlp(in_features, action_features, cells, reflections)

    def _input_reflection(self, latent_features: int, history_length: int) -> Tensor:
        observation = join_reflections(self.observation_norm.reflection)
        parts = {"history": [halves_swapped(HISTORY_FEATURES)] * history_length}
        if latent_features:
            parts["latent"] = [halves_swapped(latent_features)]
        errors = observation.diagonal()[self._commanded]
        if self.extrinsic_norm is not None:
            parts["extrinsic"] = [extrinsic := join_reflections(self.extrinsic_norm.reflection)]
            if not torch.equal(errors, extrinsic.diagonal()[self._followed]):
                raise ValueError("input_errors pair entries of unlike mirror images")
        # standard deviations change places, never signs
        parts |= {f"{name}_scale": [each.abs() for each in part] for name, part in parts.items()}
        signs = torch.cat([observation.diagonal(), errors])
        products = signs[self._gates] * signs[self._gated]
        read = [each for name in self.reads for each in parts[name]]
        return join_reflections(observation, torch.diag(errors), torch.diag(products), *read)

    def forward(self, observation: Tensor, *read: Tensor) -> Tensor:
        """Return the mean action (*B, A).

        Args:
            observation (Tensor): (*B, O), raw, in SI units, as all of them.
            *read (Tensor): one for each of :attr:`reads`: history (*B, H, O), latent (*B, L) and extrinsic state
                (*B, E), and standard deviations of the latter two in the same units.
        """
        x, given = self.observation_norm(observation), dict(zip(self.reads, read))
        errors = x[..., :0]
        if self.extrinsic_norm is not None:
            followed = given["extrinsic"][..., self._followed]
            errors = ((followed - observation[..., self._commanded]) / ERROR_SCALE).tanh()
        factors = torch.cat([x, errors], -1)
        products = factors[..., self._gates].tanh() * factors[..., self._gated]
        further = [self._normalized(name, value) for name, value in given.items()]
        outputs = self.net(torch.cat([x, INPUT_GAIN * errors, INPUT_GAIN * products, *further], -1))
        return outputs if self.output_map is None else outputs @ self.output_map

    def _normalized(self, name: str, value: Tensor) -> Tensor:
        if name == "history":
            return nn.functional.elu(self.history_net(self.observation_norm(value))).flatten(-2)
        if self.extrinsic_norm is None or name.startswith("latent"):
            return value
        return self.extrinsic_norm(value) if name == "extrinsic" else value / self.extrinsic_norm.std


def _check_pairs(name: str, pairs: Sequence[tuple[int, int]], *sizes: int) -> None:
    if any(not 0 <= index < size for pair in pairs for index, size in zip(pair, sizes, strict=True)):
        raise ValueError(f"{name}={list(pairs)} names entries beyond the {sizes[0]} and {sizes[1]} that there are.")


def _check_output_map(output_map: Tensor, actions: int) -> Tensor:
    """Return ``output_map`` in the default dtype if it is an invertible matrix of that size."""
    if output_map.shape != (actions, actions) or torch.linalg.matrix_rank(output_map.double()) < actions:
        raise ValueError(
            f"output_map must be an invertible matrix, ({actions}, {actions}), got {tuple(output_map.shape)}: every "
            "action must be within reach; None is the identity."
        )
    return output_map.to(torch.get_default_dtype()).contiguous()


def _output_reflection(reflection: Tensor, output_map: Tensor) -> Tensor:
    """Return the reflection S of the outputs y with (S y) M = R (y M), for R of the action: S = M^-T R M^T.

    Rows are brought to unit length first, D U = M, and S = D^-1 (U^-T R U^T) D: large gains beside small ones would
    cost accuracy.
    """
    gains = output_map.double().norm(dim=1)
    directions = (output_map.double() / gains.unsqueeze(-1)).T
    unit = torch.linalg.solve(directions, reflection.double() @ directions).round(decimals=4)
    return (unit * gains / gains.unsqueeze(-1)).round(decimals=4).to(output_map.dtype)


def make_actor(
    backbone: ActorBackbone,
    exploration: Exploration,
    *front: TensorDictModuleBase,
    observation: NestedKey = NetworkKeys.observation,
    history: NestedKey = NetworkKeys.history,
    act_intrinsic: NestedKey = NetworkKeys.act_intrinsic,
    act_extrinsic: NestedKey = NetworkKeys.act_extrinsic,
    act_scales: Sequence[NestedKey] = (),
    action: NestedKey = NetworkKeys.action,
) -> ProbabilisticActor:
    """Put modules that produce the act entries before a backbone and sample an action after it.

    Args:
        backbone (ActorBackbone): writes the mean action, ``loc``; shared by every actor made from it.
        exploration (Exploration): writes the standard deviations, ``scale``; shared likewise.
        *front (TensorDictModuleBase): run first, in order: encoder, estimators, act source.
        observation (NestedKey): read by the backbone.
        history (NestedKey): read by the backbone if it reads a history.
        act_intrinsic (NestedKey): read by the backbone if it reads a latent, written by the front.
        act_extrinsic (NestedKey): the same for the extrinsic state.
        act_scales (sequence of NestedKey): standard deviations of both, for a backbone that reads them.
        action (NestedKey): the output, with ``<action>_log_prob`` beside it.

    Returns:
        ProbabilisticActor: a Gaussian policy, a :class:`~torchrl_atr.modules.RotatedNormal` along the directions of the
            exploration.

    Example:
        >>> backbone = ActorBackbone(RunningNormalizer(5), RunningNormalizer(4), 3, 2)
        >>> make_actor(backbone, Exploration(2)).in_keys
        ['observation', ('act', 'intrinsic'), ('act', 'extrinsic')]
    """
    keys = {"history": history, "latent": act_intrinsic, "extrinsic": act_extrinsic}
    read = [keys[name] for name in backbone.reads if name in keys]
    mean = TensorDictModule(backbone, in_keys=[observation, *read, *act_scales], out_keys=["loc"])
    spread = TensorDictModule(exploration, in_keys=["loc"], out_keys=["scale"])
    return ProbabilisticActor(
        TensorDictSequential(*front, mean, spread),
        in_keys=["loc", "scale"],
        out_keys=[action],
        distribution_class=RotatedNormal,
        distribution_kwargs={"basis": exploration.basis},
        return_log_prob=True,
    )
