"""The page as one document that needs nothing else, with a place for data in it."""

import base64
import functools
import hashlib
from importlib import resources

__all__ = ["page_parts"]

# In the order in which they build on each other; together they are one module.
SCRIPTS = ("recording.js", "stage.js", "panels.js", "app.js")
POLICY = (
    "default-src 'none'; script-src '{script}'; style-src '{style}'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)


@functools.cache
def page_parts() -> tuple[str, str]:
    """What stands before and after the data, which is empty live: lines of JSON in a file.

    The document lets a browser run its own script alone, told by hash, and load nothing.
    """
    folder = resources.files("neurosym_robot.dashboard")
    page, style = ((folder / name).read_text() for name in ("page.html", "page.css"))
    script = "\n".join((folder / name).read_text() for name in SCRIPTS)
    policy = POLICY.format(script=_digest(script), style=_digest(style))
    for place, text in (("policy", policy), ("style", style), ("script", script)):
        page = page.replace(f"@{place}@", text)
    before, after = page.split("@data@")
    return before, after


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
