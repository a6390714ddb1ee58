"""For the site: links to files outside of docs/, which a site does not have, become their names."""

import re

_OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+[^)]*\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """Return a page's text without such links (MkDocs calls this)."""
    return _OUTSIDE.sub(r"\1", markdown)
