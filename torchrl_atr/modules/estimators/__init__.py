"""State estimators, which infer unobserved quantities from what a robot senses (docs/estimators.md).

An estimator is a factory behind a registry (:func:`register_estimator`), of one of two forms:

- ``factory(history_shape=(H, D), out_features, **kw) -> nn.Module``: a network of a window of past observations, which
  maps a history (*B, H, D), oldest first, to (*B, out_features);
- ``factory(spec, **kw) -> TensorDictModuleBase``: a TensorDict module of any entries that the robot has. It may carry a
  hidden state, add losses of its own and estimate standard deviations.

:func:`torchrl_atr.modules.check_estimator` tests either.
"""

from torchrl_atr.modules.estimators.normalized import NormalizedEstimator
from torchrl_atr.modules.estimators.parts import EstimateHead, WindowFeatures
from torchrl_atr.modules.estimators.recurrent import RecurrentEstimator
from torchrl_atr.modules.estimators.registry import (
    _ESTIMATORS,
    EstimatorError,
    EstimatorFactory,
    available_estimators,
    build_estimator,
    failure,
    get_estimator,
    register_estimator,
    require,
    takes_spec,
)
from torchrl_atr.modules.estimators.self_supervised import ContrastiveEstimator, VariationalEstimator
from torchrl_atr.modules.estimators.spec import ROLES, EstimatorSpec, Role
from torchrl_atr.modules.estimators.state import IS_INIT, state_keys, state_shapes, with_state
from torchrl_atr.modules.estimators.tensordict_module import EstimatorModule, WindowModule
from torchrl_atr.modules.estimators.uncertain import EnsembleEstimator, GaussianEstimator
from torchrl_atr.modules.estimators.window import (
    CNNGRUEstimator,
    MLPEstimator,
    TCNEstimator,
    TimeConvolution,
    TransformerEstimator,
)

__all__ = [
    "IS_INIT",
    "ROLES",
    "_ESTIMATORS",
    "CNNGRUEstimator",
    "ContrastiveEstimator",
    "EnsembleEstimator",
    "EstimateHead",
    "EstimatorError",
    "EstimatorFactory",
    "EstimatorModule",
    "EstimatorSpec",
    "GaussianEstimator",
    "MLPEstimator",
    "NormalizedEstimator",
    "RecurrentEstimator",
    "Role",
    "TCNEstimator",
    "TimeConvolution",
    "TransformerEstimator",
    "VariationalEstimator",
    "WindowFeatures",
    "WindowModule",
    "available_estimators",
    "build_estimator",
    "failure",
    "get_estimator",
    "register_estimator",
    "require",
    "state_keys",
    "state_shapes",
    "takes_spec",
    "with_state",
]
