"""What `dashpot.studies.rivals_arms` has made so far, so that a run that is stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Parts:
    """Pieces of work, one JSON file each, kept with what they were made from.

    A piece is taken as it is only if that is still the same. ``None`` as folder keeps nothing.

    Attributes:
        folder: Where they are.
        made_with: Digest of what all of them hang on; another one makes all anew.
    """

    def __init__(self, folder: Path | None, *hang_on: Path) -> None:
        self.folder = folder
        digest = hashlib.sha256()
        for path in hang_on:
            digest.update(path.read_bytes())
        self.made_with = digest.hexdigest()[:16]
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def made(self, name: str, inputs: Any, make: Callable[[], Any]) -> Any:
        """The piece of this name: as it is kept, or made now and kept.

        Args:
            name: Of the piece; its file's, with hyphens for spaces.
            inputs: What it is made from, for JSON.
            make: Makes it; its result must be what JSON gives back, infinite numbers and NaN allowed.
        """
        if self.folder is None:
            return make()
        asked = json.loads(json.dumps([self.made_with, inputs]))
        path = self.folder / f"{name.replace(' ', '-').replace(',', '')}.json"
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            if kept["from"] == asked:
                return kept["made"]
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            pass
        made = make()
        text = json.dumps({"from": asked, "made": made})
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
        return json.loads(text)["made"]
