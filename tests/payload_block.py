"""Reader of the block of numbers that pages carry, as `web/payload.js` reads it."""

import base64
import json
import re
import zlib

import numpy as np

from bulletuav.report.payload import TYPES


class Block:
    """A block: `about`, and arrays by name."""

    def __init__(self, text):
        block = zlib.decompress(base64.b64decode(text))
        size = int.from_bytes(block[:4], "little")
        self.about = json.loads(block[4 : 4 + size])
        self._rest = block[4 + size :]

    @classmethod
    def of_page(cls, page):
        return cls(re.search(r'id="payload">([^<]*)</script>', page.read_text())[1])

    def array(self, name):
        told = self.about["arrays"][name]
        kind = np.dtype(TYPES[told["kind"]])
        assert (4 + told["at"]) % min(4, kind.itemsize) == 0
        return np.frombuffer(self._rest, kind, told["length"], told["at"])

    def series(self, name):
        """Values (rows, ...) of a series, NaN where there are none, and the size of its steps."""
        low, step = self.array(f"{name} low"), self.array(f"{name} step")
        codes = self.array(f"{name} codes").reshape(len(low), -1).cumsum(axis=1, dtype=np.uint16)
        values = low[:, None] + codes * step[:, None]
        return np.where(codes == 65535, np.nan, values).T, step
