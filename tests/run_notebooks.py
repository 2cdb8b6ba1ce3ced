"""Execute notebooks, as a reader would from top to bottom, and fail on the first error; `--write` keeps what they print."""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

write = "--write" in sys.argv
for name in (a for a in sys.argv[1:] if a != "--write"):
    notebook = nbformat.read(name, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(Path(name).parent)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times of day
    print(name)
    if write:
        nbformat.write(notebook, name)
