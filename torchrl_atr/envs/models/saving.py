"""Export of a scene as one MJCF file, which MuJoCo reads as the same model."""

from __future__ import annotations

import itertools
import re
from xml.etree import ElementTree

import mujoco

from torchrl_atr.envs.models.identity import describe, differences, first_few
from torchrl_atr.envs.models.loading import blame_file, compile_spec
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import join, scene_mjspec
from torchrl_atr.envs.models.support import Support


def scene_xml(robot: RobotSpec, support: Support) -> str:
    """Return the scene as an MJCF file that MuJoCo reads as the same model, to the last bit; meshes by absolute path.

    Raises:
        RobotError: as :func:`~torchrl_atr.envs.models.build_scene`, or if MuJoCo cannot write the robot as MJCF.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround
        >>> xml = scene_xml(ROBOTS.get("a1"), FlatGround())
        >>> mujoco.MjModel.from_xml_string(xml).nu
        12
    """
    spec = scene_mjspec(robot, support)
    model = compile_spec(spec, robot)
    with blame_file(robot):
        xml = _name_classes(spec.to_xml())
        again = mujoco.MjModel.from_xml_string(xml)
    written, read = (describe(join(robot, support, each)) for each in (model, again))
    changed = differences(written, read)
    if changed:
        raise robot.error(
            f"MuJoCo does not read the scene as it writes it ({first_few(changed)}); if {robot.mjcf} attaches other "
            "models, give each <attach> a prefix"
        )
    return xml


def _name_classes(xml: str) -> str:
    """Name the classes that MuJoCo writes without a name: global defaults of models that were attached without prefix.

    Example:
        >>> _name_classes('<m><default><default><default class="leg"/></default></default></m>')
        '<m><default><default class="attached1"><default class="leg"/></default></default></m>'
    """
    taken = {element.get("class") for element in ElementTree.fromstring(xml).iter("default")}
    names = (name for i in itertools.count(1) if (name := f"attached{i}") not in taken)
    first = xml.find("<default>") + 1  # the file's own
    return xml[:first] + re.sub("<default>", lambda _: f'<default class="{next(names)}">', xml[first:])
