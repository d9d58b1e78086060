"""Files that are there whole or not at all."""

import hashlib

from simgen.whole_files import put_in_place, write_aside


def test_a_file_has_its_place_only_when_it_is_put_there(tmp_path):
    root, data = tmp_path / "root", b"\x00\xff touch" * 1000
    (root / "aside").mkdir(parents=True)
    first, second = (write_aside(root / "aside", data) for _ in range(2))
    assert sorted(root.iterdir()) == [root / "aside"]
    assert first.sha256 == hashlib.sha256(data).hexdigest()
    (root / "b").mkdir()
    (root / "b/old").write_bytes(b"before")
    put_in_place(root, {"a/new": first, "b/old": second})
    assert (root / "a/new").read_bytes() == (root / "b/old").read_bytes() == data
    assert not list((root / "aside").iterdir())
