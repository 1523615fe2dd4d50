"""What all requests have in common: errors, bodies, limits, responses, metrics and the OpenAPI document.

`problems` from exception to problem document; `responses`; `request_body` bodies and their encodings; `limits` of
connections, heads and bodies; `names` of files; `request_log` the outermost middleware; `metrics` and `readiness` for
an operator; `openapi` parts of the document for routes; `static_files` of the web page, which is in `page/`.
"""
