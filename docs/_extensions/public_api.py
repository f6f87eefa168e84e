"""Sphinx extension: pages of the public names (``__all__``) of every package, and links out of ``docs/``.

A name that several packages export is described by the first of them, and listed with a link by the others.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_PAGE = Path(__file__).parents[1] / "api.md"
PACKAGES = re.findall(r"^   (torchrl_atr[\w.]*)$", _PAGE.read_text(encoding="utf-8"), re.MULTILINE)
_LITERAL_OR_MARK = re.compile(r"(``.*?``|:\w+:`.*?`)|(\||(?<=[( ])\*(?=\w))")
_LINK = re.compile(r"(!?\[[^\[\]]*\]\()((?:\.\./)+[\w/.-]+?)/?(?:#[\w-]+)?\)")


def public_names() -> dict[str, dict[str, list[Any]]]:
    """Return what the page of each package holds: its ``listed`` names, its ``members`` and its ``data``.

    ``listed`` are classes and functions, each with the full name of its description and its first line (autosummary's
    own table would load each once more); ``members`` those that this page describes, each with its directive; ``data``
    other values with their descriptions.
    """
    homes: dict[tuple[str, int], str] = {}
    pages = {}
    for package in PACKAGES:
        module = importlib.import_module(package)
        page: dict[str, list[Any]] = {"listed": [], "members": [], "data": []}
        for name in module.__all__:
            thing = getattr(module, name)
            known = (name, id(thing)) in homes
            home = homes.setdefault((name, id(thing)), package)
            if inspect.isclass(thing) or inspect.isroutine(thing):
                page["listed"].append((f"{home}.{name}", *_escaped([(inspect.getdoc(thing) or "").partition("\n")[0]])))
                if not known:
                    page["members"].append((_directive(thing), name))
            elif not known and not name.startswith("_"):
                page["data"].append((name, _escaped(_description(package, name).splitlines())))
        pages[package] = page
    return pages


def _directive(thing: Any) -> str:
    if not inspect.isclass(thing):
        return "autofunction"
    return "autoexception" if issubclass(thing, BaseException) else "autoclass"


def _description(package: str, name: str) -> str:
    """Return the string below the assignment of a name, in the package or in the module that it is imported from."""
    body = ast.parse(Path(importlib.import_module(package).__file__ or "").read_text(encoding="utf-8")).body
    for statement, following in zip(body, [*body[1:], None]):
        if isinstance(statement, ast.ImportFrom) and any(alias.name == name for alias in statement.names):
            return _description(statement.module or "", name)
        targets = getattr(statement, "targets", [getattr(statement, "target", None)])
        named = [each for target in targets for each in (target.elts if isinstance(target, ast.Tuple) else [target])]
        if any(isinstance(each, ast.Name) and each.id == name for each in named):
            value = getattr(following, "value", None)
            return inspect.cleandoc(value.value) if isinstance(value, ast.Constant) else ""
    return ""


def _escaped(lines: list[str]) -> list[str]:
    """Return lines in which the bars of |v ω| start no substitution, and the star of (*B, D) no emphasis."""
    result, code = [], False
    for line in lines:
        code = line.lstrip().startswith(">>>") or (code and bool(line.strip()))
        result.append(line if code else _LITERAL_OR_MARK.sub(lambda found: found[1] or f"\\{found[2]}", line))
    return result


def _escape(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = _escaped(lines)


def _link_out_of_docs(app: Sphinx, name: str, source: list[str]) -> None:
    """Let links to files outside of ``docs/`` lead to copies of them, and links to folders to their README."""
    folder = Path(app.srcdir, name).parent

    def target(link: re.Match[str]) -> str:
        path = Path(link[2], "README.md") if (folder / link[2]).is_dir() else Path(link[2])
        inside = Path(os.path.normpath(folder / path)).is_relative_to(app.srcdir)
        return link[0] if inside or link[1].startswith("!") else f"{link[1]}path:{path})"

    source[0] = _LINK.sub(target, source[0])


def _find_by_defining_module(app: Sphinx, env: Any, node: Any, content: Any) -> Any:
    """Resolve a reference such as ``torchrl_atr.envs.tasks.task.Task`` to the page that describes the name."""
    name = app.config.autosummary_context["defined"].get(node.get("reftarget"))
    if name is None or node.get("refdomain") != "py":
        return None
    return env.get_domain("py").resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, content)


def _by_definition(pages: dict[str, dict[str, list[Any]]]) -> dict[str, str]:
    """Return the full names under which classes and functions are described, by those of their definitions."""
    names = [(package, name) for package, page in pages.items() for _, name in page["members"]]
    things = [getattr(importlib.import_module(package), name) for package, name in names]
    return {f"{thing.__module__}.{thing.__qualname__}": ".".join(name) for thing, name in zip(things, names)}


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    pages = public_names()
    app.config.autosummary_context = {"pages": pages, "defined": _by_definition(pages)}
    app.connect("autodoc-process-docstring", _escape, priority=900)
    app.connect("source-read", _link_out_of_docs)
    app.connect("missing-reference", _find_by_defining_module)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
