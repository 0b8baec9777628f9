"""Failures of the service that a client can cause or cure; each class carries its HTTP status and code once."""

from __future__ import annotations

from lbacal_core.errors import LbacalError


class MalformedBodyError(LbacalError, status=400, code="malformed_body"):
    """A body that is not JSON, or not HDF5 where that was announced."""


class UnauthenticatedError(LbacalError, status=401, code="no_valid_key"):
    """No valid key where one is needed."""


class ForbiddenError(LbacalError, status=403, code="scope_missing"):
    """A valid key without the scope."""


class NotFoundError(LbacalError, status=404, code="not_found"):
    """There is nothing under that name."""


class NotInEffectError(LbacalError, status=404, code="not_in_effect"):
    """No calibration is in effect at the instant; the message names the neighbours."""


class NotAcceptableError(LbacalError, status=406, code="not_acceptable"):
    """No media type that the client takes is one that the route has."""


class ConflictError(LbacalError, status=409, code="conflict"):
    """The request contradicts stored data."""


class TooLargeError(LbacalError, status=413, code="too_large"):
    """A body, or an order, above the limit."""


class UnsupportedMediaError(LbacalError, status=415, code="unsupported_media_type"):
    """A content type the route does not read."""


class SlowBodyError(LbacalError, status=408, code="slow_body"):
    """A body that does not come."""


class TooManyError(LbacalError, status=429, code="too_many"):
    """A caller asks for more than its share; `retry_s` is when to ask again."""

    def __init__(self, sentence: str, retry_s: float) -> None:
        super().__init__(sentence)
        self.retry_s = retry_s


class UnavailableError(LbacalError, status=503, code="unavailable"):
    """The database does not answer, or its schema is not the one this code needs.

    The sentence is for everybody; `detail` is what the database said, which may name hosts and roles: it is for the log
    and for whoever runs a command here. `is_passing` tells that waiting may cure it.
    """

    def __init__(self, sentence: str, detail: str = "", *, is_passing: bool = False) -> None:
        super().__init__(sentence)
        self.detail = " ".join(detail.split())
        self.is_passing = is_passing
