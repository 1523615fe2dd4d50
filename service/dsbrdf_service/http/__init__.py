"""What all requests have in common: errors, bodies, limits, responses, the log of requests and the OpenAPI document.

`problems` from exception to problem document; `responses`; `request_body` bodies and their encodings; `limits` of
connections, heads and bodies; `request_log` the outermost middleware; `openapi` parts of the document for routes.
"""
