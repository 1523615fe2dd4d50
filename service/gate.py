"""Who asks: every request has an owner, whose rows it sees and no others."""

from starlette.requests import Request

from service.rows import Caller, FitKey

CALLER = "dsbrdf.caller"  # member of the ASGI scope
_LOCAL = Caller()


def caller_of(request: Request) -> Caller:
    """Return who asks, and how much it may have."""
    caller: Caller = request.scope.get(CALLER, _LOCAL)
    return caller


def owner_of(request: Request) -> str:
    """Return whose rows the request may see: the id of its key, or '' without one."""
    return caller_of(request).owner


def fit_of(request: Request, fit_id: str) -> FitKey:
    """Return the name of the caller's fit `fit_id`."""
    return FitKey(owner_of(request), fit_id)
