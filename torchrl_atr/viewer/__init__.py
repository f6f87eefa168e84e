"""Live viewer in the browser: a riding session without a page, and the page that shows and steers it.

:class:`Session` and :class:`Loop` need no browser and no viser; the page (``page.py``, ``serve.py``) needs the extra
``viewer``. Nothing else of the package imports this one, the command line excepted.
"""

from torchrl_atr.viewer.area import CommandArea, mastered_area
from torchrl_atr.viewer.loop import Loop
from torchrl_atr.viewer.readings import Reading, Record
from torchrl_atr.viewer.session import Session, Setup
from torchrl_atr.viewer.sources import checkpoints_of, default_policy, ridable

__all__ = [
    "CommandArea",
    "Loop",
    "Reading",
    "Record",
    "Session",
    "Setup",
    "checkpoints_of",
    "default_policy",
    "mastered_area",
    "ridable",
]
