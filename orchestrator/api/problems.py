"""Errors as RFC 9457 problem+json, with the offending field and what is allowed."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from orchestrator.rest import InvalidField, Problem
from shared.errors import MotionLoopError

STATUS = {
    "invalid_input": 422,
    "not_found": 404,
    "conflict": 409,
    "overloaded": 429,
    "incompatible_peer": 409,
    "deadline_exceeded": 504,
    "unavailable": 503,
    "malformed_message": 502,
    "transport": 503,
    "simulation": 500,
}
MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 1

_CODES = {
    400: "bad_request", 401: "unauthorized", 403: "forbidden", 404: "not_found", 405: "method_not_allowed",
    413: "too_large",
}  # fmt: skip
_ALLOWED = {
    "ge": ">= {}",
    "gt": "> {}",
    "le": "<= {}",
    "lt": "< {}",
    "max_length": "at most {} characters or entries",
    "min_length": "at least {} characters or entries",
    "expected": "{}",
    "pattern": "matching {}",
    "multiple_of": "a multiple of {}",
    "expected_tags": "{}",
}


def problem_response(problem: Problem) -> JSONResponse:
    """The response for a problem; a retryable one says when."""
    headers = {"Retry-After": str(RETRY_AFTER_S)} if problem.status in (429, 503) else None
    return JSONResponse(problem.model_dump(), problem.status, headers=headers, media_type=MEDIA_TYPE)


def _motion_loop(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, MotionLoopError):
        raise error
    status = STATUS.get(error.code, 500)
    return problem_response(
        Problem(
            type=f"urn:motionloop:{error.code}",
            title=error.code.replace("_", " "),
            status=status,
            detail=error.message,
            instance=request.url.path,
            code=error.code,
            retryable=error.retryable,
            field=error.field,
            allowed=error.allowed,
        )
    )


def _allowed(context: dict[str, Any], message: str) -> str | None:
    for key, words in _ALLOWED.items():
        if key in context:
            return words.format(context[key])
    _, found, rest = message.partition("; allowed: ")
    return rest if found else ("a finite number" if "finite" in message else None)


def _validation(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    invalid = []
    for item in error.errors():
        place = [str(part) for part in item["loc"] if part not in ("body", "query", "path")]
        message = str(item["msg"]).removeprefix("Value error, ")
        allowed = _allowed(item.get("ctx") or {}, message)
        invalid.append(InvalidField(field=".".join(place) or "body", message=message, allowed=allowed))
    first = invalid[0]
    return problem_response(
        Problem(
            type="urn:motionloop:invalid_input",
            title="invalid input",
            status=422,
            detail=f"{first.field}: {first.message}",
            instance=request.url.path,
            code="invalid_input",
            field=first.field,
            allowed=first.allowed,
            errors=invalid,
        )
    )


def _http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    code = _CODES.get(error.status_code, "http_error")
    response = problem_response(
        Problem(
            title=code.replace("_", " "),
            status=error.status_code,
            detail=str(error.detail),
            instance=request.url.path,
            code=code,
        )
    )
    response.headers.update(error.headers or {})
    return response


def _bug(request: Request, error: Exception) -> JSONResponse:
    """What nobody foresaw: the log has the traceback, the caller learns nothing of the inside."""
    said = "an error of the server; its log says more"
    return problem_response(
        Problem(title="internal error", status=500, detail=said, instance=request.url.path, code="internal")
    )


def install(app: FastAPI) -> None:
    """Let an app answer every error as a problem."""
    app.add_exception_handler(MotionLoopError, _motion_loop)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(Exception, _bug)


RESPONSES: dict[int | str, dict[str, Any]] = {
    400: {"model": Problem, "description": "Not HTTP or JSON as it should be", "content": {MEDIA_TYPE: {}}},
    401: {"model": Problem, "description": "A token is needed", "content": {MEDIA_TYPE: {}}},
    403: {
        "model": Problem,
        "description": "This token, host or endpoint will not do",
        "content": {MEDIA_TYPE: {}},
    },
    413: {"model": Problem, "description": "The body is too large", "content": {MEDIA_TYPE: {}}},
    429: {"model": Problem, "description": "Too many requests, characters or episodes", "content": {MEDIA_TYPE: {}}},
    502: {"model": Problem, "description": "A service sent what cannot be read", "content": {MEDIA_TYPE: {}}},
    504: {"model": Problem, "description": "A service did not answer in time", "content": {MEDIA_TYPE: {}}},
    422: {"model": Problem, "description": "A value is not allowed; nothing was changed", "content": {MEDIA_TYPE: {}}},
    404: {"model": Problem, "description": "No such thing", "content": {MEDIA_TYPE: {}}},
    409: {"model": Problem, "description": "Not possible in the present state", "content": {MEDIA_TYPE: {}}},
    503: {"model": Problem, "description": "A service is away or overloaded", "content": {MEDIA_TYPE: {}}},
}
