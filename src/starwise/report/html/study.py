"""Page of a reproduced paper: its report with tables and figures, the paper's beside ours."""

import base64
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from starwise.report.html.beside import beside
from starwise.report.html.page import rendered

_IMAGE = re.compile(r'<img src="([^"]*)"')
_PAPERS = {
    "s3ekf": "Sequential square-root-free EKF (S3EKF)",
    "rdss_sins": "Late fixes of RDSS in an inertial filter",
    "adaptive_federated": "Adaptive federated filter",
    "stability": "Controllability, observability and stability",
}


def study_page(text: str, folder: str | Path, paper: str = "", result: Mapping[str, Any] | None = None) -> bytes:
    """Report in Markdown as one HTML file, with the figures it names (SVG beside it) inside.

    Parameters
    ----------
    text : str
        Markdown as `starwise reproduce` writes it; HTML in it is shown, not interpreted.
    folder : path-like
        Where its figures are.
    paper : str
        Short name of the paper.
    result : mapping, optional
        What ``reproduce.json`` holds: its numbers are shown beside the paper's.
    """
    from markdown_it import MarkdownIt
    from markupsafe import Markup

    title, body = _titled(text)
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    html = parser.render(body)
    html = html.replace("<table>", '<div class="tabled"><table>').replace("</table>", "</table></div>")
    html = _IMAGE.sub(lambda found: f'<img loading="eager" src="{_inlined(Path(folder), found.group(1))}"', html)
    head, html = _sectioned(html)
    headings = re.findall(r"<h2>(.*?)</h2>", html)
    for i in range(len(headings)):
        html = html.replace("<h2>", f'<h2 id="s{i}">', 1)
    return rendered(
        "study.html",
        None,
        title=title,
        eyebrow=_PAPERS.get(paper, "Reproduced"),
        groups=beside(paper, result or {}),
        headings=[Markup(heading) for heading in headings],
        head=Markup(head),
        body=Markup(html),
    )


def _sectioned(html: str) -> tuple[str, str]:
    """What stands before the sections, and the sections in panels of their own; the figures in a grid at the end."""
    figures = re.findall(r"<img [^>]*>", html)
    head, *rest = re.sub(r"<p>(\s*<img [^>]*>\s*)+</p>", "", html).split("<h2>")
    out = "".join(f'<section class="panel"><h2>{part}</section>' for part in rest)
    if figures:
        shown = "".join(f'<figure class="panel">{figure}</figure>' for figure in figures)
        out += f'<section><h2>Figures</h2><div class="figures">{shown}</div></section>'
    return head, out


def _titled(text: str) -> tuple[str, str]:
    head, _, rest = text.partition("\n")
    return (head.removeprefix("# ").strip(), rest) if head.startswith("# ") else ("Reproduced", text)


def _inlined(folder: Path, name: str) -> str:
    """Figure as a data address; a picture cannot run anything. Empty where it is not a file of this folder."""
    file = folder / Path(name).name
    if file.suffix != ".svg" or not file.is_file():
        return ""
    return "data:image/svg+xml;base64," + base64.b64encode(file.read_bytes()).decode("ascii")
