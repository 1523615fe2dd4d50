"""The decomposition of a fit into specular spike, specular lobe and diffuse part."""

from fastapi import APIRouter, Request
from starlette.responses import Response

from service.access.authentication import fit_of
from service.context import context_of
from service.http import examples, openapi
from service.http.responses import tagged_reply
from service.routes.fits import FitId
from service.wire.conversions import component_document
from service.wire.schemas import ComponentList

router = APIRouter(prefix="/v1/fits/{fit_id}/lobes", tags=["lobes"])


@router.get(
    "",
    response_model=ComponentList,
    summary="The components of a fit",
    responses=openapi.example(examples.COMPONENTS, "The components, from narrow to wide.")
    | openapi.problems("not-found", "fit-not-finished"),
)
async def get_components(request: Request, fit_id: FitId) -> Response:
    """Return the three components with their lobes, albedo, half width and how clear the label is."""
    decomposition = await context_of(request).models.decomposition(fit_of(request, fit_id))
    document = ComponentList(items=[component_document(component) for component in decomposition])
    return tagged_reply(request, document.model_dump_json().encode())
