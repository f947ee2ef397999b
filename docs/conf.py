"""Sphinx: MyST pages whose code runs while they are built; no page needs the network."""

import inspect
import re

from fraclink import __version__

project = "fraclink"
author = "The fraclink developers"
copyright = "2026, The fraclink developers"
release = version = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True  # pages may write files; none of them into the sources
nb_merge_streams = True

# Formulas are written in Unicode: the usual renderer would fetch a script from elsewhere.
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"fraclink {version}"
html_static_path = ["_static"]
html_css_files = ["fraclink.css"]
html_show_sphinx = False
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}  # numpy's own spelling of it fills three lines
# "What is this name" must have an answer: an undefined symbol is a failed build (make docs adds -W).
nitpicky = False
suppress_warnings = ["myst.strikethrough"]
default_role = "code"


def plain_text(app, what, name, obj, options, lines) -> None:
    """Docstrings are plain text with formulas: a bar in |L(jω)| must not begin a substitution."""
    example = False
    for number, line in enumerate(lines):
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if not example:
            parts = re.split(r"(``.*?``)", line)
            lines[number] = "".join(part if part.startswith("``") else escaped(part) for part in parts)


def escaped(text: str) -> str:
    """Bars and the stars of references (θt*) written so that they stay what they are."""
    return re.sub(r"\||(?<=θ)\*|\*(?=\()", r"\\\g<0>", text)


def short_signature(app, what, name, obj, options, signature, return_annotation):
    """The fields of a noun by name: their types and ranges stand below, the annotations would fill a page."""
    if what != "class":
        return None
    fields = inspect.signature(obj).parameters.values()
    shown = [field.name + ("" if field.default is field.empty else "=…") for field in fields]
    return f"({', '.join(shown)})", None


def setup(app) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-process-docstring", plain_text)
