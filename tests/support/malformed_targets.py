"""Ids, paths, queries and methods that no honest client sends."""

MARK = "@"  # stands for an id that exists

_OUT_OF_THE_FOLDER = """
    .. ../../etc/passwd ..%2f..%2f..%2fetc%2fpasswd %2e%2e/%2e%2e/dsbrdf.sqlite ..%5c..%5cwindows ..\\..\\windows
    %252e%252e%252fetc%252fpasswd ..%c0%af..%c0%afetc%c0%afpasswd %e0%80%ae%e0%80%ae/ %uff0e%uff0e/ ..;/..;/etc/passwd
    .%00./.%00./ %2fetc%2fpasswd //etc/passwd file:///etc/passwd ~root @/../@ @/..%2f@ ..%2fblobs%2f@ @%2f..%2f@
"""
_NEARLY_AN_ID = """
    @%00 %00@ @%0a @%0d%0aX-Evil:%20yes @%20 %20@ @. @/ @// @;x=y @%3f @%23 @%ef%bb%bf @%e2%80%8b @0 0@ @@ @,@ @.json
    @: @%2e @'-- @%25
"""
_OTHER_WORDS = """
    0 -1 1e9 null NaN * {fit_id} [0] _ . % %zz %80 %ff%fe %ed%a0%80 %F0%9F%92%A9 $(id) `id` @%7Cid %7B%7B7*7%7D%7D
    '%20OR%20'1'='1 1;DROP%20TABLE%20fits $%7Bjndi:ldap:%2f%2fx%7D %3Cscript%3Ealert(1)%3C%2fscript%3E %1b%5b2J
    %0aINFO%20fake
"""
_LONG = ["%D9%A3" * 32, "%F0%9D%9F%98" * 32, "a" * 31, "a" * 33, "a" * 63, "a" * 65, "%61" * 4000, "A" * 32, "g" * 32]
_LONG += ["G" * 64, "_" * 32, "%25" * 32]
IDS = [*_OUT_OF_THE_FOLDER.split(), *_NEARLY_AN_ID.split(), *_OTHER_WORDS.split(), *_LONG]

TARGETS = [
    ("GET", "/v1/fits/{id}"),
    ("GET", "/v1/measurements/{id}"),
    ("DELETE", "/v1/fits/{id}"),
    ("DELETE", "/v1/measurements/{id}"),
    ("GET", "/v1/fits/{id}/brdf?theta_half_deg=1&theta_diff_deg=1"),
    ("GET", "/v1/fits/@/components/{id}/brdf?theta_half_deg=1&theta_diff_deg=1"),
]

_PATHS = """
    //v1/fits /v1//fits /v1/fits/ /./v1/fits /v1/../v1/fits /v1/fits/../measurements /V1/fits /v1/fits;x=y /v1/fits%20
    /v1/fits%00 /v1/fits%0a /v1/fits%3Flimit=1 /v1/fits%23 /v1 /v2/fits /%2fv1/fits /v1/fits/@/ /v1/fits/@//brdf
    /v1/fits/@/nothing /v1/fits/@/export/ /v1/fits/@/events/.. /.env /dsbrdf.sqlite /data/dsbrdf.sqlite /blobs /run
    /cgi-bin/../../bin/sh /openapi.json/ /docs/.. /static/../../etc/passwd /health/ http://evil.example/v1/fits
    //evil.example/v1/fits v1/fits * ? \\v1\\fits
"""
PATHS = [
    *_PATHS.split(),
    "/" + "a" * 60_000,
    "/" + "../" * 5000 + "etc/passwd",
    "/v1/fits?" + "x=" * 20_000,
    "/v1/fits/" + "%2e" * 20_000,
]

_OF_LISTS = """
    limit=9999999999999999999999 limit=1%20OR%201=1 limit= limit[]=1 limit=%D9%A3 cursor=1;DROP%20TABLE%20fits
    cursor=%00 cursor=1%0a cursor=%D9%A3 cursor= __proto__=1
"""
_OF_A_FIT = """
    ?wait=1e999 ?wait= ?waits=1 /export?format=..%2f..%2fetc%2fpasswd /export?format=json&component=..
    /export?format=json%00 /export?format=JSON /brdf?theta_half_deg=-1e-9&theta_diff_deg=1
    /brdf?theta_half_deg=1e999&theta_diff_deg=1 /brdf?theta_half_deg=__import__('os')&theta_diff_deg=1
    /brdf?theta_half_deg=%00&theta_diff_deg=1 /brdf?omega_in=0,0,1&theta_diff_deg=1
    /brdf?theta_half_deg=%D9%A3&theta_diff_deg=1
"""
QUERIES = [
    *(f"/v1/fits?{query}" for query in _OF_LISTS.split()),
    *(f"/v1/fits/@{query}" for query in _OF_A_FIT.split()),
    "/v1/measurements?order=created",
    "/v1/fits/@/brdf?" + "theta_half_deg=1&" * 3000,
]

_METHODS = "PUT PATCH TRACE OPTIONS CONNECT PROPFIND get Post FOO DELETE POST/x %47ET"
METHODS = [*_METHODS.split(), "G" * 5000, "GET\t"]
