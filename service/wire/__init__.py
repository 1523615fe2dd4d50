"""From bytes and text to the library's objects, and back.

`schemas` the JSON documents; `fit_options`; `points`; `conversions` from rows and models to documents;
`values_stream` responses with values; `examples` for the OpenAPI document.
"""
