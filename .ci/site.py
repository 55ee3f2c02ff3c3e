"""What MkDocs needs beside docs/: pages from elsewhere, outer links, equations without scripts, accessibility."""

import html
import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
PLACES = {  # page of the site: file of the repository, where that is another one
    "index.md": "README.md", "pages.md": "docs/README.md",
    "CONTRIBUTING.md": "CONTRIBUTING.md", "SECURITY.md": "SECURITY.md", "CHANGELOG.md": "CHANGELOG.md",
}  # fmt: skip
API = """# Python reference

[Python](python.md) has examples.

::: alight
    options:
      show_root_heading: false
"""
LINK = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files, config):
    """Add the pages that do not lie in docs/."""
    files.remove(files.get_file_from_path("README.md"))
    for page, name in PLACES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    files.append(File.generated(config, "api.md", content=API))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links as they work in the repository into those of the site."""
    own = page.file.src_uri
    behind = own.startswith(("lab/", "method/", "CHANGELOG", "architecture", "scene-keys"))
    page.meta["search"] = {"boost": 0.5 if behind else 2 if own in {"reading-the-report.md", "settings.md"} else 1}
    folder = dirname(PLACES.get(own, join("docs", own)))
    pages = {name: page for page, name in PLACES.items()}

    def moved(match):
        text, target, heading = match[1], match[2], match[3] or ""
        path = normpath(join(folder, target))
        inside = pages.get(path, relpath(path, "docs"))
        if not inside.startswith(".."):
            return f"[{text}]({relpath(inside, dirname(own) or '.')}{heading})"
        return f"[{text}]({config.repo_url.rstrip('/')}/blob/main/{path})" if config.repo_url else text

    return LINK.sub(moved, markdown)


def on_page_content(content, **_):
    """Turn equations into MathML, with their numbers behind them."""

    def drawn(match):
        name, latex = match[1], html.unescape(match[2]).strip()[2:-2]
        tag = re.search(r"\\tag\{([^}]*)\}", latex)
        math = convert(latex.replace(tag[0], "") if tag else latex, display="block" if name == "div" else "inline")
        if not tag:
            return f"<{name}>{math}</{name}>"
        return f'<div style="display: flex; align-items: center"><div style="flex: 1">{math}</div>({tag[1]})</div>'

    return re.sub(r'<(div|span) class="arithmatex">(.*?)</\1>', drawn, content, flags=re.S)


def on_post_page(output, **_):
    """Name the search dialog for screen readers."""
    return output.replace('component="search" role="dialog"', 'component="search" role="dialog" aria-label="Search"')
