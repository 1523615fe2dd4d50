"""What a file is by its first bytes, to tell a user who sends something else than a measurement."""

# None of these begins a MERL file, an RGL .bsdf file or a table of samples.
_KINDS = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"v/1\x01": "an OpenEXR image",
    b"#?": "a Radiance image",
    b"PK\x03\x04": "a ZIP archive or an .npz file",
    b"\x1f\x8b": "gzip, without the header Content-Encoding: gzip if it was sent over HTTP",
    b"\x28\xb5\x2f\xfd": "zstd, without the header Content-Encoding: zstd if it was sent over HTTP",
    b"\x93NUMPY": "a .npy array",
    b"\x89HDF": "an HDF5 file",
    b"tensor_file\0": "an RGL .bsdf file, which dsbrdf convert turns into a MERL file",
    b"{": "JSON, or another text",
    b"<": "HTML or XML",
}


def known_kind(start: bytes) -> str | None:
    """Return the kind of file that begins with these bytes, such as "a PNG image"; None for any other."""
    return next((kind for magic, kind in _KINDS.items() if start.startswith(magic)), None)
