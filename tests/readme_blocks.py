"""Run the code of Markdown pages, as a reader would from top to bottom, each page in an empty folder.

    ```python                   runs, in one namespace a page
    ```bash                     runs, by `bash -e`
    ```toml title="row.toml"    is written to that file, in any language
    anything else               is shown only

Pages share a process, which spares the imports and what JAX has compiled; JAX's float64 switch is set back after each. What is
deprecated is an error.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import jax

BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?[^\n]*\n(.*?)^```', re.S | re.M)


def run_page(page: Path) -> None:
    namespace: dict[str, object] = {"__name__": "__main__"}
    for number, (language, title, text) in enumerate(BLOCK.findall(page.read_text()), 1):
        where = f"{page} block {number}"
        if title:
            Path(title).write_text(text)
        elif language == "python":
            print(where)
            exec(compile(text, where, "exec"), namespace)
        elif language == "bash":
            print(where)
            subprocess.run(["bash", "-ec", text], check=True)


if __name__ == "__main__":
    warnings.simplefilter("error", DeprecationWarning)
    for page in [Path(name).resolve() for name in sys.argv[1:]]:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            run_page(page)
            os.chdir(page.parent)
        jax.config.update("jax_enable_x64", False)
        print(f"{page.name}: {time.perf_counter() - start:.1f} s", flush=True)
