"""Networks as TensorDictModules: they know keys and shapes, never an env.

The encoder, the estimators (a registry and a conformance check), the actor, its exploration and input sources, the
critic, and :func:`make_networks`, which builds them all from an env's specs.
"""

from torchrl_atr.modules.act_scale import ActScale
from torchrl_atr.modules.act_source import (
    ACT_SOURCES,
    ACTOR_INPUTS,
    ActorInput,
    ActSource,
    ActSourceName,
    AssignActSource,
)
from torchrl_atr.modules.action_noise import CorrelatedGaussian, RotatedNormal, with_correlated_noise
from torchrl_atr.modules.actor import ActorBackbone, make_actor
from torchrl_atr.modules.checks import check_estimator
from torchrl_atr.modules.command_range import COMMAND_RANGE_FILE, CommandClippedPolicy, CommandRange
from torchrl_atr.modules.critic import AsymmetricCritic
from torchrl_atr.modules.encoder import IntrinsicEncoder
from torchrl_atr.modules.estimators import (
    CNNGRUEstimator,
    EstimateHead,
    EstimatorError,
    EstimatorModule,
    EstimatorSpec,
    MLPEstimator,
    NormalizedEstimator,
    WindowFeatures,
    available_estimators,
    get_estimator,
    register_estimator,
    with_state,
)
from torchrl_atr.modules.exploration import Exploration, hadamard_leg_basis
from torchrl_atr.modules.fingerprint import fingerprint
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.network_factory import make_networks
from torchrl_atr.modules.networks import ROANetworks
from torchrl_atr.modules.normalization import RunningNormalizer
from torchrl_atr.modules.placement import DeviceBridge
from torchrl_atr.modules.single_estimator import make_estimator
from torchrl_atr.modules.symmetry import EquivariantLinear, equivariant_mlp

__all__ = [
    "ACTOR_INPUTS",
    "ACT_SOURCES",
    "COMMAND_RANGE_FILE",
    "ActScale",
    "ActSource",
    "ActSourceName",
    "ActorBackbone",
    "ActorInput",
    "AssignActSource",
    "AsymmetricCritic",
    "CNNGRUEstimator",
    "CommandClippedPolicy",
    "CommandRange",
    "CorrelatedGaussian",
    "DeviceBridge",
    "EquivariantLinear",
    "EstimateHead",
    "EstimatorError",
    "EstimatorModule",
    "EstimatorSpec",
    "Exploration",
    "IntrinsicEncoder",
    "MLPEstimator",
    "NetworkKeys",
    "NormalizedEstimator",
    "ROANetworks",
    "RotatedNormal",
    "RunningNormalizer",
    "WindowFeatures",
    "available_estimators",
    "check_estimator",
    "equivariant_mlp",
    "fingerprint",
    "get_estimator",
    "hadamard_leg_basis",
    "make_actor",
    "make_estimator",
    "make_networks",
    "register_estimator",
    "with_correlated_noise",
    "with_state",
]
