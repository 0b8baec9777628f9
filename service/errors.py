"""Failures of the service that a client can cause or cure; each class carries its HTTP status and code once."""

from __future__ import annotations

from lbacal_core.errors import LbacalError


class MalformedBodyError(LbacalError):
    """A body that is not JSON, or not HDF5 where that was announced."""

    status = 400
    code = "malformed_body"


class UnauthenticatedError(LbacalError):
    """No valid key where one is needed."""

    status = 401
    code = "no_valid_key"


class ForbiddenError(LbacalError):
    """A valid key without the scope."""

    status = 403
    code = "scope_missing"


class NotFoundError(LbacalError):
    """There is nothing under that name."""

    status = 404
    code = "not_found"


class NotInEffectError(LbacalError):
    """No calibration is in effect at the instant; the message names the neighbours."""

    status = 404
    code = "not_in_effect"


class NotAcceptableError(LbacalError):
    """No media type that the client takes is one that the route has."""

    status = 406
    code = "not_acceptable"


class ConflictError(LbacalError):
    """The request contradicts stored data."""

    status = 409
    code = "conflict"


class TooLargeError(LbacalError):
    """A body, or an order, above the limit."""

    status = 413
    code = "too_large"


class UnsupportedMediaError(LbacalError):
    """A content type the route does not read."""

    status = 415
    code = "unsupported_media_type"


class SlowBodyError(LbacalError):
    """A body that does not come."""

    status = 408
    code = "slow_body"


class TooManyError(LbacalError):
    """A caller asks for more than its share; `retry_s` is when to ask again."""

    status = 429
    code = "too_many"

    def __init__(self, sentence: str, retry_s: float) -> None:
        super().__init__(sentence)
        self.retry_s = retry_s


class UnavailableError(LbacalError):
    """The database does not answer, or its schema is not the one this code needs.

    The sentence is for everybody; `detail` is what the database said, which may name hosts and roles: it is for the log
    and for whoever runs a command here. `is_passing` tells that waiting may cure it.
    """

    status = 503
    code = "unavailable"

    def __init__(self, sentence: str, detail: str = "", *, is_passing: bool = False) -> None:
        super().__init__(sentence)
        self.detail = " ".join(detail.split())
        self.is_passing = is_passing
