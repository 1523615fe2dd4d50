"""Handle the parts of HTTP that all requests have in common.

`middleware` bounds connections, request heads and bodies, and logs requests; `messages` reads bodies and makes answers,
and `problems` makes answers from exceptions; `monitoring` is for an operator; `openapi` describes routes;
the web page is in `page/`.
"""
