"""Example of a custom transporter: a skateboard, which rolls freely and is steered by roll alone.

Run it:  torchrl-atr train --import examples.skateboard --transporter skateboard --total-frames 100000
"""

import torch

from torchrl_atr.envs.models import TRANSPORTER_DESIGNS, TRANSPORTERS, Board, Hinge, TransporterDesign, TransporterSpec

WHEELBASE, STEERING = 0.6, 0.8
"""Distance of the trucks, m, and their turn per radian of roll, rad."""
RESPONSE = 0.1
"""Time constant with which the yaw rate follows the trucks, s."""


def skate(tilt, speeds, transporter, interpretation):
    """Compute the drive's accelerations: none forward; in yaw, ω follows v tan(-k θ_x) / L.

    A robot cannot push itself off here, so the board gets its speed from pushes or a moving start.

    Returns:
        m/s² and rad/s², (N, 2), before resistance and for a board of nominal mass.
    """
    wanted = speeds[:, 0] * torch.tan(-STEERING * tilt[:, 1].clamp(-1.0, 1.0)) / WHEELBASE
    return torch.stack([torch.zeros_like(wanted), (wanted - speeds[:, 1]) / RESPONSE], -1)


SKATEBOARD = TransporterDesign(
    boards=(Board("deck", 0.0, 1.0, (Hinge("truck_roll", (1.0, 0.0, 0.0), gain=0),)),),
    driving=((0.0,), (1.0,)),  # no forward tilt; the steering tilt is the one hinge's angle
    attitude=((0.0,), (1.0,)),  # it does not pitch; it rolls with the hinge
    drive=skate,
)
TRANSPORTER_DESIGNS.register("skateboard", SKATEBOARD)
TRANSPORTERS.register("skateboard", TransporterSpec("skateboard", SKATEBOARD, (0.9, 0.5, 0.05), mass=5.0))
