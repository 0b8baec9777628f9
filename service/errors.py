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
    """Nothing under that name."""

    status = 404
    code = "not_found"


class NotInEffectError(LbacalError):
    """No calibration is in effect at the instant; the message names the neighbours."""

    status = 404
    code = "not_in_effect"


class ConflictError(LbacalError):
    """What was sent contradicts what is stored."""

    status = 409
    code = "conflict"


class TooLargeError(LbacalError):
    """A body above the limit."""

    status = 413
    code = "too_large"


class UnsupportedMediaError(LbacalError):
    """A content type the route does not read."""

    status = 415
    code = "unsupported_media_type"


class UnavailableError(LbacalError):
    """The database does not answer, or its schema is not the one this code needs."""

    status = 503
    code = "unavailable"
