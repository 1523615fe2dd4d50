"""Series of kills, crowds of clients, full disks and damaged folders, each against a real server."""
