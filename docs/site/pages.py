"""What makes a site of the repository's Markdown: a hook of MkDocs, named in mkdocs.yml.

Nothing is written twice. The home page is README.md, model cards come from beside their checkpoints, and API pages
from docstrings (`rooms`), which are read without importing anything. `NAVIGATION` orders the guide; a page of docs/
that it does not name follows under "More", so a new one needs no line here. Links are those that work in the
repository: here they lead to the same file's page, and what has none, a script or a settings file, gets one under
source/. A link to what is not there is left to MkDocs, whose strict mode fails on it.
"""

from __future__ import annotations

import logging
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from rooms import ROOMS, api_index, api_page, class_identifiers, identifier, is_there, read_module, undocumented

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
LOG = logging.getLogger("mkdocs.hooks.pages")

NAVIGATION = {
    "Guide": (
        *("quickstart", "commands", "python", "simulate", "scenes", "terrain", "training", "data", "evaluation"),
        *("retuned", "inverse", "formats", "export", "extend"),
    ),
    "Measured": (
        *("results", "chart", "charts/general/chart", "charts/columns/chart", "charts/plane/chart", "reductions"),
        *("stability", "trust", "performance", "reference", "shallow"),
    ),
}
PROJECT = {"The trajectory file": "SCHEMA.md", "Decisions": "decisions.md"}
BORROWED = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
CARDS = "src/gns_pl/pretrained"

# In Markdown: code, which stays as it is, or the target of a link, an image, a definition or an HTML attribute.
MARKDOWN = re.compile(
    r"^(?P<fence>`{3,}|~{3,}).*?^(?P=fence)|(?<!`)(?P<ticks>`+)(?!`).+?(?<!`)(?P=ticks)(?!`)"
    r"|(?<=\]\()(?P<link>[^)\s]+)|^\[[^]\n]+\]:[ ]+(?P<definition>\S+)"
    r"|\b(?:src|href|poster)=\"(?P<attribute>[^\"]+)\"",
    re.MULTILINE | re.DOTALL,
)
# In HTML: what is a link, a heading or a listing already; a piece of code; any other tag; the name of a document.
HTML = re.compile(
    r"<(?P<closed>a|pre|h[1-6]|autoref|script)\b.*?</(?P=closed)>|<code>(?P<code>[\w.]+)(?:\([^<]*\))?</code>"
    r"|<code\b.*?</code>|<[^>]*>|(?<![\w/])(?P<document>(?:docs/)?\w+\.md)\b",
    re.DOTALL,
)


def place(path: str) -> str | None:
    """Return where on the site a path of the repository is shown; None if there is no such file."""
    if path in BORROWED:
        return BORROWED[path]
    if path.startswith("docs/") and (ROOT / path).is_file():
        return path.removeprefix("docs/")
    if posixpath.dirname(path) == CARDS and path.endswith(".md") and (ROOT / path).is_file():
        return f"models/{posixpath.basename(path)}"
    room = path.removeprefix("src/gns_pl/").removesuffix(".py")
    if path.startswith("src/gns_pl/") and room in ROOMS:
        return f"api/{room}.md"
    if not (ROOT / path).exists() or path.startswith(".."):
        return None
    if path.endswith(".md"):
        return f"source/{path}"
    return f"source/{path}.md" if is_text(ROOT / path) else f"source/{path}"


def is_text(path: Path) -> bool:
    """Return whether a file, or a folder's list, is shown as a page; what is not is copied."""
    return path.is_dir() or path.suffix in ("", ".py", ".yaml", ".yml", ".toml", ".txt", ".cff", ".html", ".sh")


def resolve(target: str, origin: str) -> str | None:
    """Return the path in the repository that a link in the file `origin` means; None for one that leads elsewhere."""
    path = unquote(target.partition("#")[0])
    if not path or path.startswith("/") or ":" in path:
        return None
    return posixpath.normpath(posixpath.join(posixpath.dirname(origin), path))


def links(markdown: str) -> Iterator[str]:
    """Yield the targets of all links outside code."""
    for match in MARKDOWN.finditer(markdown):
        target = match["link"] or match["definition"] or match["attribute"]
        if target:
            yield target


def relinked(markdown: str, origin: str) -> str:
    """Return the text of the file `origin` with every link leading from its page to the page of what it means."""
    here = posixpath.dirname(place(origin) or "")

    def replaced(match: re.Match[str]) -> str:
        target = match["link"] or match["definition"] or match["attribute"]
        path = resolve(target, origin) if target else None
        if path is None:
            return match[0]
        found = place(path)
        if found is None:
            if match["attribute"]:  # MkDocs does not look into HTML
                LOG.warning("%s leads to %s, which is not there.", origin, target)
            return match[0]
        if match["attribute"]:
            found = re.sub(r"\.md$", ".html", found)
        _, mark, anchor = target.partition("#")
        return match[0].replace(target, posixpath.relpath(found, here or ".") + mark + anchor)

    return MARKDOWN.sub(replaced, markdown)


def documents() -> dict[str, str]:
    """Return the Markdown files that are pages in their own right, their path by where they are shown."""
    own = [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))]
    cards = [f"{CARDS}/{path.name}" for path in sorted((ROOT / CARDS).glob("*.md"))]
    return {str(place(path)): path for path in [*BORROWED, *own, *cards]}


def sources(origins: list[str]) -> dict[str, str]:
    """Return what else the files `origins` link to, and what that links to: paths by where they are shown."""
    found: dict[str, str] = {}
    waiting = list(origins)
    while waiting:
        origin = waiting.pop()
        for target in links((ROOT / origin).read_text(encoding="utf-8")):
            path = resolve(target, origin)
            shown = place(path) if path else None
            if path and shown and shown.startswith("source/") and shown not in found:
                found[shown] = path
                if path.endswith(".md"):
                    waiting.append(path)
    return found


def source_page(path: str) -> str:
    """Return the page of a file that is not Markdown, or of a folder."""
    if (ROOT / path).is_dir():
        names = sorted(f"{entry.name}/" if entry.is_dir() else entry.name for entry in (ROOT / path).iterdir())
        return f"# {path}/\n\n" + "".join(f"- `{name}`\n" for name in names if not name.startswith(("__", ".")))
    language = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".toml": "toml", ".sh": "bash"}
    text = (ROOT / path).read_text(encoding="utf-8")
    return f"# {path}\n\n``````{language.get(Path(path).suffix, 'text')}\n{text}\n``````\n"


def cross_referenced(html: str, page: str, classes: dict[str, str]) -> str:
    """Return a page's HTML with code that names a part of the package, and names of documents, as links."""

    def replaced(match: re.Match[str]) -> str:
        if match["code"] and (full := identifier(match["code"], classes)):
            if match["code"].startswith("gns_pl.") and not is_there(full):
                LOG.warning("%s names %s, which is not there.", page, full)
            return f'<autoref identifier="{full}" optional>{match[0]}</autoref>'
        if match["document"]:
            path = match["document"]
            shown = place(path) or place(f"docs/{path}")
            if shown and shown != page:
                target = re.sub(r"\.md$", ".html", posixpath.relpath(shown, posixpath.dirname(page) or "."))
                return f'<a href="{target}">{path}</a>'
        return match[0]

    return HTML.sub(replaced, html)


def navigation() -> list[dict[str, object]]:
    """Return MkDocs' `nav`: every document, every card and every room, once."""
    pages = list(documents())
    chosen = {title: [f"{name}.md" for name in names if f"{name}.md" in pages] for title, names in NAVIGATION.items()}
    project = [*PROJECT.values(), "contributing.md", "changelog.md"]
    cards = [page for page in pages if page.startswith("models/")]
    named = {"index.md", *project, *cards, *(page for some in chosen.values() for page in some)}
    more = [page for page in pages if page not in named]
    return [
        {"Home": "index.md"},
        *({title: some} for title, some in chosen.items() if some),
        *([{"More": more}] if more else []),
        {"Models": cards},
        {"API": ["api/index.md", *({room: f"api/{room}.md"} for room in ROOMS)]},
        {"Project": [{title: page} for title, page in PROJECT.items()] + ["contributing.md", "changelog.md"]},
    ]


# What MkDocs calls.


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the navigation; forget what an earlier build of `mkdocs serve` read."""
    read_module.cache_clear()
    class_identifiers.cache_clear()
    config.nav = navigation()
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/."""
    from mkdocs.structure.files import File, InclusionLevel

    pages = documents()
    for shown, path in pages.items():
        if not path.startswith("docs/"):
            files.append(File.generated(config, shown, content=(ROOT / path).read_text(encoding="utf-8")))
    files.append(File.generated(config, "api/index.md", content=api_index()))
    for room in ROOMS:
        files.append(File.generated(config, f"api/{room}.md", content=api_page(room)))
    for shown, path in sources(list(pages.values())).items():
        if shown.endswith(".md"):
            content = (ROOT / path).read_text(encoding="utf-8") if path.endswith(".md") else source_page(path)
            files.append(File.generated(config, shown, content=content, inclusion=InclusionLevel.NOT_IN_NAV))
        else:
            files.append(File.generated(config, shown, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links lead to pages of the site."""
    shown = page.file.src_uri
    if shown == "index.md":
        page.meta["hide"] = ["navigation"]  # there is one page in its section
    origin = documents().get(shown) or (shown.removeprefix("source/") if shown.startswith("source/") else None)
    return relinked(markdown, origin) if origin and origin.endswith(".md") and (ROOT / origin).is_file() else markdown


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Make links of what is named."""
    if page.file.src_uri.startswith("api/") and page.title in ROOMS:
        for name in undocumented(html, page.title):
            LOG.warning("gns_pl.%s exports %s, which lacks a docstring, or a module in ROOMS.", page.title, name)
    return cross_referenced(html, page.file.src_uri, class_identifiers())
