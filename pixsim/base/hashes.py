"""Hash of JSON content, which names entries of the cache, rows of results and random streams."""

from __future__ import annotations

import hashlib
import json


def content_hash(content: object) -> str:
    """Hash of JSON content, independent of the order of keys: BLAKE2b, 16 hexadecimal digits."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
