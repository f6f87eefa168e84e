"""Navigation: maps, planned paths, path following and energy, for any policy that takes (c_v, c_ω)."""

from torchrl_atr._errors import MissingPackageError
from torchrl_atr.evaluation.energy import CostOfTransport, Power, cost_of_transport, measure_power

try:
    import ompl  # noqa: F401
    import shapely  # noqa: F401
except ModuleNotFoundError as error:
    raise MissingPackageError(error.name or "shapely", "navigation") from None
from torchrl_atr.navigation.map import Map, MapError, load_map, map_names
from torchrl_atr.navigation.paths import Path, PathError, plan, plan_all
from torchrl_atr.navigation.pursuit import PurePursuit, PursuitConfig
from torchrl_atr.navigation.trips import TripsResult, run_trips

__all__ = [
    "CostOfTransport",
    "Map",
    "MapError",
    "Path",
    "PathError",
    "Power",
    "PurePursuit",
    "PursuitConfig",
    "TripsResult",
    "cost_of_transport",
    "load_map",
    "map_names",
    "measure_power",
    "plan",
    "plan_all",
    "run_trips",
]
