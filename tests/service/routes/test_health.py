"""Health."""

from tests.support.server import Server


def test_health_endpoints_answer(server: Server) -> None:
    for name in ("live", "ready"):
        answer = server.http.get(f"/health/{name}")
        assert answer.status_code == 200
        assert answer.json()["status"] == name
    assert server.http.get("/docs").status_code == 200
