"""Finished measurements of a reproduction on disk: what is there is not made again."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torchrl_atr._files import whole, write_json

RECORD = "part.json"


class Parts:
    """Folder of measurements, each in a subfolder whose name holds a hash of what was asked for.

    Args:
        folder: of them; it need not exist.

    Attributes:
        seconds: that the parts got from here took to make, by folder, whenever that was.

    Example:
        >>> import tempfile
        >>> parts = Parts(Path(tempfile.mkdtemp()))
        >>> def make(folder):
        ...     print("measuring")
        ...     _ = (folder / "value.txt").write_text("1", encoding="utf-8")
        >>> parts.get("ride", {"seed": 0}, make) == parts.get("ride", {"seed": 0}, make)
        measuring
        True
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.seconds: dict[Path, float] = {}

    def place(self, name: str, asked: Mapping[str, Any]) -> Path:
        """Return the folder of a part, made or not.

        Args:
            name: of the part.
            asked: all that it depends on, as JSON values.
        """
        text = json.dumps(asked, sort_keys=True)
        return self.folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"

    def get(self, name: str, asked: Mapping[str, Any], make: Callable[[Path], object]) -> Path:
        """Return the folder of a part, made by ``make(folder)`` if it is not there yet; arguments of :meth:`place`."""
        folder = self.place(name, asked)
        if not self.holds(folder):
            begin = time.monotonic()
            with whole(folder) as staged:
                make(staged)
            self.finish(folder, asked, time.monotonic() - begin)
        return folder

    def holds(self, folder: Path) -> bool:
        """Return whether a part is made, and count its seconds if it is."""
        made = (folder / RECORD).is_file()
        if made:
            self.seconds[folder] = json.loads((folder / RECORD).read_text(encoding="utf-8"))["seconds"]
        return made

    def finish(self, folder: Path, asked: Mapping[str, Any], seconds: float) -> None:
        """Mark a part as made; for parts that take longer than one session and keep their own state."""
        write_json(folder / RECORD, {"asked": asked, "seconds": round(seconds, 1)})
        self.seconds[folder] = round(seconds, 1)
