"""Distillation of a teacher's policy: a student imitates its actions, and its estimators learn by regression."""

from __future__ import annotations

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import dispatch

from torchrl_atr.objectives.roa import ROAClipPPOLoss


class DistillationLoss(ROAClipPPOLoss):
    r"""Squared distance of the actor's mean action from a teacher's, :math:`\|\mu - \mu^*\|^2`, in place of PPO.

    ``policy_loss`` is ``loss_imitation`` alone, a sum over actions and mean over samples. Its gradient goes to the
    actor, and to the encoder of an actor that acts on the latent, not to exploration, critic and estimators. The data
    must hold ``teacher_mean``, the teacher's mean action in the states that the student visits (DAgger). The estimators
    are trained by :meth:`adaptation_loss` as in :class:`~torchrl_atr.objectives.ROAClipPPOLoss`, whose arguments these
    are.

    TorchRL's :class:`~torchrl.objectives.BCLoss` computes the same from a second, functional copy of the actor, which
    samples, without masks.

    Example:
        >>> from torchrl.data import Composite, Unbounded
        >>> from torchrl_atr.modules import make_networks
        >>> privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
        >>> spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
        >>> nets = make_networks(spec, Unbounded((2,)), actor_reads=["history"])
        >>> loss = DistillationLoss(nets.training_actor(), nets.critic_module)
        >>> data = spec.expand(8).rand()
        >>> loss.policy_loss(data.set("teacher_mean", Unbounded((8, 2)).rand()))["loss_imitation"].shape
        torch.Size([])
    """

    @property
    def policy_in_keys(self) -> list[NestedKey]:
        """Entries that :meth:`policy_loss` reads; masks are optional."""
        return [*self.actor_network.in_keys, self.tensor_keys.teacher_mean, *self._mask_keys]

    def further_in_keys(self) -> list[NestedKey]:
        """Return the inputs of the adaptation networks, and their targets."""
        return self.adaptation_in_keys if hasattr(self, "_estimators") else []

    def _set_in_keys(self) -> None:
        self._in_keys = list({*self.policy_in_keys, *self.further_in_keys()})

    @property
    def out_keys(self) -> list[NestedKey]:
        """Keys of the imitation term and of the adaptation terms."""
        if self._out_keys is None:
            terms = [key for key in self.further_out_keys() if key not in ("loss_roa", "loss_smoothness")]
            self._out_keys = ["loss_imitation", *terms]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, values: list[NestedKey]) -> None:
        self._out_keys = values

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``loss_imitation`` and both estimator losses, with diagnostics."""
        return self.policy_loss(tensordict).update(self.adaptation_loss(tensordict))

    def policy_loss(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``loss_imitation``.

        Raises:
            KeyError: if the data hold no mean action of a teacher.
        """
        key = self.tensor_keys.teacher_mean
        target = tensordict.get(key, None)
        if target is None:
            raise KeyError(
                f"no mean action of a teacher, {key!r}, in the data; write it there, or name it with "
                "loss.set_keys(teacher_mean=...)"
            )
        error = self._distribution(self._act(tensordict)).mean - target
        return TensorDict({"loss_imitation": self._reduced(error.square().sum(-1), tensordict)})
