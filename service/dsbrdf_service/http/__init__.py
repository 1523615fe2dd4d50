"""Handle the parts of HTTP that all requests have in common.

`request_log` is the middleware; `limits` bounds connections, request heads and bodies; `request_body` receives and
decodes bodies; `responses` makes answers, and `problems` makes them from exceptions; `names` checks names of files;
`metrics` and `readiness` are for an operator; `openapi` describes routes; `static_files` sends the web page, which is
in `page/`.
"""
