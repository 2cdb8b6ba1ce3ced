"""Run every Python block of a Markdown file, in order, in one namespace."""

import re
import sys
from pathlib import Path

namespace: dict[str, object] = {}
for number, block in enumerate(re.findall(r"```python\n(.*?)```", Path(sys.argv[1]).read_text(), re.S), 1):
    print(f"block {number}")
    exec(compile(block, f"{sys.argv[1]} block {number}", "exec"), namespace)
