"""HTTP routes, one file a noun: a route parses, makes one call and returns a document."""
