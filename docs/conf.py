"""Sphinx: MyST pages whose code is executed during the build; no page needs network
access.
"""

import os
import sys
import tempfile
from pathlib import Path

from fraclink import __version__
from fraclink.view._pages import colours

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

# Figures that the code of a page draws itself have the colours of the package's drawings.
# The kernels read the file, and the colours of matplotlib have no "#".
_colour = {name: value.removeprefix("#") for name, value in colours().items()}
_lines = ", ".join(f"'{_colour[f'line-{k}']}'" for k in range(1, 5))
_style = Path(tempfile.mkdtemp(), "matplotlibrc")
_style.write_text(f"""\
axes.prop_cycle: cycler('color', [{_lines}])
axes.grid: True
axes.axisbelow: True
axes.spines.top: False
axes.spines.right: False
axes.edgecolor: {_colour["quiet"]}
axes.labelcolor: {_colour["ink"]}
axes.titlesize: medium
text.color: {_colour["ink"]}
xtick.color: {_colour["quiet"]}
ytick.color: {_colour["quiet"]}
grid.color: {_colour["faint"]}
lines.linewidth: 1.3
legend.fontsize: small
""")
os.environ["MATPLOTLIBRC"] = str(_style)

project = "fraclink"
author = "The fraclink developers"
copyright = "2026, The fraclink developers"
release = version = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "docstrings",
    "linked_names",
    "accessible",
    "command_pages",
    "moving_arm",
    "picture_directives",
    "quiet_kernels",
]
myst_enable_extensions = ["deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True  # pages may write files, but not into the sources
nb_merge_streams = True
# a table returned by a cell becomes a table of the page
nb_render_markdown_format = "myst"

# Formulas are written in Unicode: the usual renderer would load a script from the
# network.
# names of partial pages begin with an underscore
exclude_patterns = ["_build", "**/_*.md"]
html_theme = "furo"
html_title = f"fraclink {version}"
html_static_path = ["_static"]
html_css_files = ["fraclink.css"]
html_js_files = [("copy.js", {"defer": "defer"})]
html_show_sphinx = False
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
# Written out, numpy's own type takes up three lines of a signature.
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}
# The types in docstrings are words with shapes and units; the links are in the
# signature.
napoleon_use_param = False
napoleon_use_rtype = False
# as in parameters: several names share a line
napoleon_custom_sections = [("Attributes", "params_style")]

# Every reference must resolve: an undefined symbol fails the build (make docs adds -W).
nitpicky = True
# Types of other projects: their inventories are on the network, which a build does not
# need.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|np|control|matplotlib|pathlib|fractions|collections\.abc)\..+"),
    (r"py:.*", r"ArrayLike|NDArray|TypeAliasForwardRef|Axes|Path|(typing\.)?Self"),
    (
        r"py:.*",
        r".*typing\.(Annotated|Literal)\[.*",
    ),  # a range or a choice in a signature, split at its comma
    (r"py:class", r"tuple\[float|fracsys\.checks\.ranges\.Array"),  # likewise
    # Private types in signatures of public functions: the text explains their meaning.
    (
        r"py:class",
        r"fraclink\.trials\._fault_trial\.FaultTrial"
        r"|fraclink\._simulate\.kernel\.ArmState|fraclink\.view\._drawing\.Figure",
    ),
    (
        r"py:class",
        r"fraclink\._files\.[TU]|Goal|Following|Specification|fraclink\._display\.Kind|fraclink\._arm\.log_columns\..+",
    ),
    (r"py:class", r"fraclink\._identify\.validation\.Value"),
    (r"py:class", r"fraclink\._arm\.log_columns\.(ColumnStatement|LogColumns \|.*)"),
    (r"py:class", r"fraclink\.trials\._fault_trial\.FaultTrial"),
    (r"py:class", r"fraclink\.view\._text\.View"),
]
suppress_warnings = ["myst.strikethrough"]
default_role = "code"
