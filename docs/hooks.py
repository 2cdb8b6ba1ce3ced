"""Hooks of mkdocs beside `mkdocs.yml`: where the notebooks lie, that all public names are documented, and the demo's files."""

from __future__ import annotations

import contextlib
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
import demo_files
from public import ROOT, faults


@event_priority(100)  # before mkdocs-jupyter looks for them
def on_files(files: Files, config: Any) -> Files:
    """The notebooks, which lie beside this folder."""
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        files.append(File(f"notebooks/{path.name}", str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to notebooks, which in the repository lie beside this folder, as the site has them."""
    return re.sub(r"\]\(\.\./((?:\.\./)?notebooks/)", r"](\1", markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Links of notebooks to pages, which in the repository lie in the folder beside theirs, as the site has them."""
    at_home = page.file.src_uri.startswith("notebooks/")
    return re.sub(r'href="\.\./docs/([^"#]+)\.md', r'href="../../\1/', html) if at_home else html


def on_pre_build(config: Any) -> None:
    """Raises where a public name has no docstring, or a package no page."""
    found = faults()
    if found:
        raise PluginError("; ".join(found))


def on_post_build(config: Any) -> None:
    """The demo's files; without a linker for WebAssembly the page says that they are not there."""
    with contextlib.suppress(ValueError):
        demo_files.write(Path(config.site_dir) / "demo")
