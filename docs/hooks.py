"""What MkDocs does otherwise than git hosts: links to files outside docs/, and bars in the code of a table.

A page links to ``../examples/own_hardware.py`` as a git host wants it. In the site that file becomes a page
of its own, ``files/examples/own_hardware.html``, made here, and the link points there.
"""

import html
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"(?<=\]\()((?:\.\./)+[^)#\s]+)(?=[)#])")
BARRED = re.compile(r"`([^`\n]*\\\|[^`\n]*)`")
LANGUAGE = {".py": "python", ".toml": "toml", ".xml": "xml", ".c": "c", ".h": "c", ".json": "json"}


def _outside(page: str, link: str) -> Path | None:
    """The repository's file that a page's link leads to, if it lies outside docs/."""
    path = Path(posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link)))
    return None if path.parts[0] in ("docs", "..") or not (ROOT / path).is_file() else path


def on_files(files, config):
    """Adds a page for every file that a page links to outside docs/."""
    found = set()
    for page in files.documentation_pages():
        found |= {
            path for link in LINK.findall(page.content_string) if (path := _outside(page.src_uri, link))
        }
    for path in sorted(found):
        text = (ROOT / path).read_text(encoding="utf-8")
        language = LANGUAGE.get(path.suffix, "text")
        head = f"---\nsearch:\n  exclude: true\n---\n\n# {path.name}\n\n`{path.as_posix()}`\n\n"
        body = f"{head}````{language}\n{text}````\n"
        files.append(File.generated(config, f"files/{path.as_posix()}.md", content=body))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turns such links round to those pages; a table's ``\\|`` within code is a bar without its backslash."""
    here = page.file.src_uri

    def turned(match):
        path = _outside(here, match[1])
        if path is None:
            return match[1]
        return posixpath.relpath(f"files/{path.as_posix()}.md", posixpath.dirname(here) or ".")

    def shown(match):
        return f"<code>{html.escape(match[1]).replace(chr(92) + '|', '&#124;')}</code>"

    return BARRED.sub(shown, LINK.sub(turned, markdown))
