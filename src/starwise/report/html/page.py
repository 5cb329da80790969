"""A page as one file: template, style, script and plotly in it; nothing is fetched, nothing else may run."""

import base64
import hashlib
from functools import cache
from pathlib import Path
from typing import Any, Final

from starwise._version import __version__
from starwise.errors import StarwiseError
from starwise.report.html.encode import safe_json

_HERE: Final = Path(__file__).parent
_SCRIPTS: Final = (
    "core.js",
    "axes.js",
    "strips.js",
    "maps.js",
    "sensors.js",
    "compare.js",
    "diagnosis.js",
    "inspector.js",
    "main.js",
)


@cache
def plotly_js() -> str:
    """Plotly's script, out of the installed package; its Python part is not imported.

    Raises
    ------
    StarwiseError
        The package is not there, or does not have it where it used to be.
    """
    from importlib.util import find_spec

    spec = find_spec("plotly")
    home = Path(spec.origin).parent if spec is not None and spec.origin else None
    file = None if home is None else home / "package_data" / "plotly.min.js"
    if file is None or not file.is_file():
        raise StarwiseError("plotly's script is not installed", found=str(file), wanted="pip install plotly")
    return file.read_text(encoding="utf-8").replace("</script", "<\\/script")


@cache
def own_js() -> str:
    """The page's own script."""
    parts = [(_HERE / "assets" / name).read_text(encoding="utf-8") for name in _SCRIPTS]
    return '(() => {\n"use strict";\n' + "\n".join(parts) + "\n})();"


@cache
def style() -> str:
    """The page's style sheet."""
    return (_HERE / "assets" / "page.css").read_text(encoding="utf-8")


@cache
def _hash(text: str) -> str:
    """Source expression of a script for the page's security policy."""
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii") + "'"


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def rendered(template: str, data: dict[str, Any] | None, **context: Any) -> bytes:
    """Page of a template, UTF-8.

    Parameters
    ----------
    template : str
        Name of a file of the package.
    data : dict or None
        What the script draws; without it no script is in the page but the switch of colours.
    **context
        What the template shows; every value is escaped.
    """
    from markupsafe import Markup

    plotly = "" if data is None else plotly_js()
    policy = (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
        "script-src " + " ".join(_hash(text) for text in (own_js(), plotly) if text)
    )
    page = (
        _environment()
        .get_template(template)
        .render(
            policy=policy,
            style=Markup(style()),
            script=Markup(own_js()),
            plotly=Markup(plotly),
            data=Markup(safe_json(data if data is not None else {})),
            version=__version__,
            **context,
        )
    )
    return str(page).encode("utf-8")
