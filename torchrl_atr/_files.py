"""Atomic writing of files and folders, with errors that name the path and the remedy."""

from __future__ import annotations

import codecs
import errno
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_ESCAPE = "torchrl_atr.escape"
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
    """Return the file, what is wrong with it, and the remedy.

    Example:
        >>> explain(OSError(errno.ENOTDIR, "Not a directory", "notes.txt/run"))
        'notes.txt/run: Not a directory; it is in the way: choose another path'
    """
    if error.strerror is None:  # not from the operating system
        return str(error)
    remedy = _REMEDIES.get(error.errno or 0, "check the path")
    return f"{error.filename or 'a file'}: {error.strerror}; {remedy}"


@contextmanager
def folder_for(path: str | Path) -> Iterator[Path]:
    """Make a folder, parents included, for what the block writes; if the block fails, empty ones are removed.

    A test file is written at once, to fail now rather than after an hour's work.

    Args:
        path: of the folder; one that exists stays, whatever happens.

    Yields:
        The same path.

    Raises:
        OSError: if it cannot be made or written to; names the folder.

    Example:
        >>> home = Path(tempfile.mkdtemp())
        >>> with folder_for(home / "runs" / "report") as folder:
        ...     raise ValueError("nothing to write")
        Traceback (most recent call last):
        ValueError: nothing to write
        >>> list(home.iterdir())
        []
    """
    with _made(Path(path)) as folder:
        with naming(folder), tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"a full disk shows when something is written")
        yield folder


@contextmanager
def _made(folder: Path) -> Iterator[Path]:
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    except BaseException:
        with suppress(OSError):  # not made, or not empty: then its parents stay, too
            for each in missing:
                each.rmdir()
        raise


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Yield a folder to write files to; they move to the folder ``path`` together when the block ends without an error.

    Raises:
        OSError: if they cannot be written; names ``path``.

    Example:
        >>> target = Path(tempfile.mkdtemp())
        >>> with whole(target) as folder:
        ...     _ = (folder / "note.txt").write_text("all", encoding="utf-8")
        ...     list(target.glob("*.txt"))
        []
        >>> [file.name for file in target.iterdir()]
        ['note.txt']
    """
    with _made(Path(path)) as target, naming(path):
        temporary = target / f".{os.getpid()}.part"
        try:
            temporary.mkdir()
            yield temporary
            try:
                _move_files(temporary, target)
            except KeyboardInterrupt:  # mixed files of two reports would be worse than a late end
                _move_files(temporary, target)
                raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _move_files(source: Path, target: Path) -> None:
    for file in sorted(source.iterdir()):
        os.replace(file, target / file.name)


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Name ``path`` in errors of the operating system inside the block: those of a full disk name nothing."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:
            error.filename, error.filename2 = str(path), None
        raise


def write_json(path: Path, value: Any, allow_nan: bool = True) -> None:
    """Write ``value``, whole or not at all, in ASCII: words of a command line may hold bytes that are not text.

    Raises:
        ValueError: if it holds NaN or infinity, which other readers of JSON refuse, and ``allow_nan`` is False.
    """
    with atomic(path) as file:
        file.write_text(json.dumps(value, indent=2, allow_nan=allow_nan) + "\n", encoding="utf-8")


def say(text: str, end: str = "\n") -> None:
    """Write a line to standard output; a pipe whose reader has left must not end hours of work."""
    try:
        with naming("standard output"):
            sys.stdout.write(text + end)
            sys.stdout.flush()
    except BrokenPipeError:
        _write_nowhere()


def flush() -> None:
    """Flush standard output, where it can be written: the interpreter's own flush at exit would report an error."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):  # its reader is gone, the disk is full, or it has been closed
        _write_nowhere()


def _write_nowhere() -> None:
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _escape(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    first = UnicodeEncodeError(error.encoding, error.object, error.start, error.start + 1, error.reason)
    try:
        return codecs.lookup_error("surrogateescape")(first)
    except UnicodeEncodeError:
        return codecs.backslashreplace_errors(first)


def prepare_output() -> None:
    r"""Let standard output and error take any text in any encoding: what it lacks is written as ``\u03c9``.

    Names of files that are not text in this locale are written as the bytes that they are.
    """
    codecs.register_error(_ESCAPE, _escape)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the parent process
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        stream = getattr(sys, name)
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_ESCAPE)


def sweep(folder: Path) -> None:
    """Remove the temporary files of :func:`atomic` and :func:`whole` that a killed process left."""
    for path in folder.glob(".*.part*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a path to write to; it becomes ``path``, whole, when the block ends without an error.

    The temporary file has the same suffix, since writers choose formats by it.

    Raises:
        OSError: if it cannot be written; names ``path``.

    Example:
        >>> target = Path(tempfile.mkdtemp()) / "note.txt"
        >>> with atomic(target) as file:
        ...     _ = file.write_text("whole", encoding="utf-8")
        >>> target.read_text(encoding="utf-8")
        'whole'
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    with _made(path.parent), naming(path):
        if path.exists() and not path.is_file():  # a folder; or a device, which the replacement would remove
            raise FileExistsError(errno.EEXIST, "not a file")
        try:
            temporary.touch()  # the writer's own error may be less clear
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
