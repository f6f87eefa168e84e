"""Files appear whole or not at all, and what keeps them from appearing is said."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_FREE = "free some space; a run goes on from its last checkpoint with --resume"
_CHOOSE = "choose a path that you may write to"
_AWAY = "it is in the way: choose another path"
_REMEDIES = {
    errno.ENOSPC: _FREE,
    errno.EDQUOT: _FREE,
    errno.EACCES: _CHOOSE,
    errno.EPERM: _CHOOSE,
    errno.EROFS: _CHOOSE,
    errno.EEXIST: _AWAY,
    errno.ENOTDIR: _AWAY,
    errno.EISDIR: _AWAY,
    errno.EFBIG: "raise the limit of file sizes (ulimit -f)",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def explain(error: OSError) -> str:
    """The file, what is wrong with it, and what to do.

    Example:
        >>> explain(OSError(errno.ENOTDIR, "Not a directory", "notes.txt/run"))
        'notes.txt/run: Not a directory; it is in the way: choose another path'
    """
    if error.strerror is None:  # not from the operating system
        return str(error)
    remedy = _REMEDIES.get(error.errno or 0, "check the path")
    return f"{error.filename or 'a file'}: {error.strerror}; {remedy}"


def make_folder(path: str | Path) -> None:
    """Makes a folder, parents included, and tries to write to it: better now than after an hour's work.

    Raises:
        OSError: if it cannot be made or written to; names the folder.
    """
    path = Path(path)
    path.mkdir(parents=True, exist_ok=True)
    with naming(path), tempfile.TemporaryFile(dir=path) as file:
        file.write(b"a full disk shows when something is written")


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Errors of the operating system inside the block name ``path``: those of a full disk name nothing."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:
            error.filename, error.filename2 = str(path), None
        raise


def write_json(path: Path, value: Any) -> None:
    """Writes ``value``, whole or not at all."""
    with atomic(path) as file:
        file.write_text(json.dumps(value, indent=2) + "\n")


def say(text: str) -> None:
    """Writes a line for whoever reads; a pipe whose reader has left must not end hours of work."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # nor may the interpreter's own flush complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def sweep(folder: Path) -> None:
    """Removes what a killed process left of files that it was writing with :func:`atomic`, and of such folders."""
    for path in folder.glob(".*.part*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """A path to write to; it becomes ``path``, whole, when the block ends without an error.

    The temporary file has the same suffix, since writers choose formats by it.

    Raises:
        OSError: if it cannot be written; names ``path``.

    Example:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "note.txt"
        >>> with atomic(target) as file:
        ...     _ = file.write_text("whole")
        >>> target.read_text()
        'whole'
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    with naming(path):
        if path.exists() and not path.is_file():  # a folder; or a device, which the replacement would abolish
            raise FileExistsError(errno.EEXIST, "not a file")
        try:
            temporary.touch()  # whoever writes it may say less clearly why it cannot be written
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
