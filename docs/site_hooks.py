"""What mkdocs does besides: files of the project that a page links to are pages of the site, so that the site is whole without any host.

On a line of its own such a link is followed by the file itself.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"\]\(((?:\.\./)+)([^)#\s]+)(#[^)\s]*)?\)")
ALONE = re.compile(r"^\[[^\]]*\]\((?:\.\./)+([^)#\s]+)\)$", re.M)
LANGUAGES = {".py": "python", ".c": "c", ".h": "c", ".md": "markdown"}


def outside(page: str, up: str, path: str) -> str:
    """The file of the project that a link of `page` means; empty where that is a page of the documentation."""
    target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), up, path))
    return "" if target.startswith("docs/") else target


def listing(target: str) -> str:
    """A file as a block of code; a folder as the list of its files."""
    path = ROOT / target
    if path.is_dir():
        return "".join(f"- `{file.name}`\n" for file in sorted(path.iterdir()) if not file.name.startswith("_"))
    return f"````{LANGUAGES.get(path.suffix, 'text')}\n{path.read_text(encoding='utf-8').rstrip()}\n````\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds a page for each file of the project that a page links to."""
    targets = set()
    for file in files.documentation_pages():
        for up, path, _ in LINK.findall(file.content_string):
            targets.add(outside(file.src_uri, up, path))
    for target in sorted(targets - {""}):
        if not (ROOT / target).exists():
            raise FileNotFoundError(f"a page links to {target}, which is not there")
        content = f"---\nsearch:\n  exclude: true\n---\n\n# {target}\n\n{listing(target)}"
        files.append(File.generated(config, f"source/{target.rstrip('/')}.md", content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links to files of the project lead to their pages."""
    source = page.file.src_uri
    if source.startswith("source/"):
        return markdown

    def shown(found: re.Match[str]) -> str:
        return f"{found.group()}\n\n{listing(found.group(1))}"

    def link(found: re.Match[str]) -> str:
        up, path, _ = found.groups()
        target = outside(source, up, path)
        if not target:
            return found.group()
        return f"]({posixpath.relpath(f'source/{target}.md', posixpath.dirname(source) or '.')})"

    return LINK.sub(link, ALONE.sub(shown, markdown))
