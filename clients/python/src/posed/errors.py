"""What can go wrong, as exceptions: all of them are `PosedError`s."""

from __future__ import annotations

from ._schema import Job

__all__ = ["Disconnected", "JobFailed", "NoProgram", "PosedError", "Refused", "Unauthorised"]


class PosedError(Exception):
    """Anything that this package raises by itself."""


class Refused(PosedError):
    """The daemon answered a request with `error`: a `code` for programs, a sentence for people."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code
        """`bad_request`, `unknown_sensor`, `forbidden`, `busy`, `not_found`, ..."""


class Disconnected(PosedError):
    """There is no connection, or it broke before the answer."""


class Unauthorised(Disconnected):
    """The daemon wants a token, or does not take this one. Nobody tries again."""


class JobFailed(PosedError):
    """A job that was waited for failed or was cancelled."""

    def __init__(self, job: Job) -> None:
        super().__init__(job["message"] or job["state"])
        self.job = job
        """As the topic `jobs` tells it."""


class NoProgram(PosedError):
    """A recording holds only the devices' bytes, and the program `posed`, which makes poses of them, is not there."""
