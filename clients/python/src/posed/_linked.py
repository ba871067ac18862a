"""What a connection says of itself, whether it is awaited or blocks."""

from __future__ import annotations

import numpy as np

from ._link import Link
from ._schema import Hello


class Linked:
    """Has a link, which was greeted before anybody has this."""

    _link: Link

    @property
    def url(self) -> str:
        """Of the websocket."""
        return self._link.url

    @property
    def connected(self) -> bool:
        """Whether there is a connection just now."""
        return self._link.connected

    @property
    def hello(self) -> Hello:
        """Who speaks, and what there is: of the newest connection."""
        assert self._link.hello is not None, "it was greeted when it was opened"
        return self._link.hello

    @property
    def epoch_utc(self) -> np.datetime64:
        """The stage's epoch, from which `t_s` counts."""
        return self._link.epoch_utc
