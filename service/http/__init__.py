"""What is common to all requests: problems, bodies, limits, answers and the OpenAPI document."""
