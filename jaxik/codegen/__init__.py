"""Functions as machine code for programs without Python: C, C++, NumPy alone, a browser.

In order: `functions` trace one of one configuration and name what it takes and returns, `refusals` say in one line what cannot
be done, `names` which ones C has free, `targets` are the processors, `one_row` and `entries` write what C calls around the
kernel compiler's program (`jaxik.spmd`), `archive` and `header` are the library's files, `python_loader` and `webassembly`
those of other callers, `library` writes them. `robot_functions` are those of a robot, `robot_header` tells of its joints, and
`robot_folder` is a folder with an example and a test of its own.
"""

from jaxik.codegen.functions import Field, Function
from jaxik.codegen.library import Exported, export
from jaxik.codegen.robot_folder import export_robot
from jaxik.codegen.robot_functions import FUNCTIONS
from jaxik.codegen.targets import TARGETS

__all__ = ["FUNCTIONS", "TARGETS", "Exported", "Field", "Function", "export", "export_robot"]
