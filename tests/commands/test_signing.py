"""Signatures: an archive that somebody else made, or that was changed in any byte, is never taken for the signer's."""

from __future__ import annotations

import base64
import json
import random
import shutil
import stat
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from cosim.__main__ import main
from cosim.signing import SignatureError, check_signed, new_key, sign, verify
from tests.support.c_fmus import tank


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a signed FMU, and with the keys of its maker and of somebody else."""
    folder = tmp_path_factory.mktemp("signed")
    tank(folder / "tank.fmu", members={"resources/table.txt": "1 2 3"})
    for name in ("maker", "other"):
        new_key(folder / name)
    sign(folder / "tank.fmu", folder / "maker")
    return folder


@pytest.fixture
def here(signed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, as working folder."""
    for path in signed.iterdir():
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys: pytest.CaptureFixture[str]) -> str:
    out, err = capsys.readouterr()
    return out + err


def test_what_is_signed_verifies_and_equal_archives_have_equal_signatures(here: Path) -> None:
    found = verify(Path("tank.fmu"), [Path("other.pub"), Path("maker.pub")])
    assert found.key == Path("maker.pub")
    assert found.members == len(zipfile.ZipFile("tank.fmu").namelist()) == 3
    before = Path("tank.fmu.sig").read_bytes()
    sign(Path("tank.fmu"), Path("maker"))
    assert Path("tank.fmu.sig").read_bytes() == before


@pytest.mark.skipif(shutil.which("openssl") is None, reason="OpenSSL's program is the oracle")
def test_openssl_takes_keys_and_signature(here: Path) -> None:
    content = json.loads(Path("tank.fmu.sig").read_text())
    Path("document").write_text(content["document"])
    Path("signature").write_bytes(base64.b64decode(content["signature"]))
    command = [
        "openssl",
        "pkeyutl",
        "-verify",
        "-pubin",
        "-inkey",
        "maker.pub",
        "-rawin",
        "-in",
        "document",
        "-sigfile",
        "signature",
    ]
    assert subprocess.run(command, check=False, capture_output=True).returncode == 0
    command[command.index("maker.pub")] = "other.pub"
    assert subprocess.run(command, check=False, capture_output=True).returncode != 0
    subprocess.run(["openssl", "genpkey", "-algorithm", "ed25519", "-out", "theirs"], check=True, capture_output=True)
    subprocess.run(["openssl", "pkey", "-in", "theirs", "-pubout", "-out", "theirs.pub"], check=True)
    sign(Path("tank.fmu"), Path("theirs"))
    assert verify(Path("tank.fmu"), [Path("theirs.pub")]).key == Path("theirs.pub")
    subprocess.run(["openssl", "genpkey", "-algorithm", "RSA", "-out", "rsa"], check=True, capture_output=True)
    with pytest.raises(SignatureError, match="rsa: is not an Ed25519 key"):
        sign(Path("tank.fmu"), Path("rsa"))


def test_any_changed_byte_is_found(here: Path) -> None:
    whole = Path("tank.fmu").read_bytes()
    for place in random.Random(1).sample(range(len(whole)), 40):
        changed = bytearray(whole)
        changed[place] ^= 1
        Path("tank.fmu").write_bytes(changed)
        with pytest.raises(SignatureError, match=r"tank\.fmu: was changed after it was signed with maker\.pub"):
            verify(Path("tank.fmu"), [Path("maker.pub")])
    Path("tank.fmu").write_bytes(whole + b"\0")
    with pytest.raises(SignatureError, match="members are the same, but packed otherwise"):
        verify(Path("tank.fmu"), [Path("maker.pub")])


def test_any_changed_byte_of_the_signature_is_found(here: Path) -> None:
    whole = Path("tank.fmu.sig").read_bytes()
    text = json.loads(whole)
    for place in random.Random(2).sample(range(len(whole)), 60):
        changed = bytearray(whole)
        changed[place] ^= 1
        Path("tank.fmu.sig").write_bytes(changed)
        try:
            verify(Path("tank.fmu"), [Path("maker.pub")])
        except SignatureError:
            continue
        again = json.loads(changed)  # what is not signed: the name of the key, and white space
        assert {k: again[k] for k in ("document", "signature")} == {k: text[k] for k in ("document", "signature")}


def test_changed_added_and_removed_members_are_named(here: Path) -> None:
    with zipfile.ZipFile("tank.fmu") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["modelDescription.xml"] += b"<!-- -->"
    del members["resources/table.txt"]
    members |= {f"resources/{i}": b"" for i in range(9)}
    with zipfile.ZipFile("tank.fmu", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(SignatureError) as refused:
        verify(Path("tank.fmu"), [Path("maker.pub")])
    what = "changed: modelDescription.xml; added: resources/0, resources/1, resources/2, resources/3, resources/4 and 4"
    assert f"({what} more; removed: resources/table.txt)" in str(refused.value)


def test_another_signer_is_another_signer(here: Path) -> None:
    with pytest.raises(SignatureError, match=r"was not signed with other\.pub, but with the key SHA256:") as refused:
        verify(Path("tank.fmu"), [Path("other.pub")])
    own = str(refused.value).partition("with the key ")[2].partition(";")[0]
    sign(Path("tank.fmu"), Path("other"))
    with pytest.raises(SignatureError, match=r"was not signed with maker\.pub"):
        verify(Path("tank.fmu"), [Path("maker.pub")])
    content = json.loads(Path("tank.fmu.sig").read_text())
    Path("tank.fmu.sig").write_text(json.dumps({**content, "key": own}))  # that claims to be the maker's
    with pytest.raises(SignatureError, match=r"tank\.fmu\.sig: was changed, or is damaged"):
        verify(Path("tank.fmu"), [Path("maker.pub")])


def test_a_signature_of_another_document_is_none_for_an_archive(here: Path) -> None:
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    key = load_pem_private_key(Path("maker").read_bytes(), None)
    content = json.loads(Path("tank.fmu.sig").read_text())
    for document in ("{}", "[]", "a letter", '{"format": "cosim archive signature 1"}'):
        signature = base64.b64encode(key.sign(document.encode())).decode()  # type: ignore[union-attr,call-arg,arg-type]
        Path("tank.fmu.sig").write_text(json.dumps({**content, "document": document, "signature": signature}))
        with pytest.raises(
            SignatureError, match=r"tank\.fmu\.sig: (is not a signature of this kind|its document lacks)"
        ):
            verify(Path("tank.fmu"), [Path("maker.pub")])


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", "no JSON", '{"document": 1, "key": "k", "signature": "AA=="}', "[" * 9999]
)
def test_what_is_no_signature_is_refused_in_a_line(here: Path, text: str) -> None:
    Path("tank.fmu.sig").write_text(text)
    with pytest.raises(SignatureError, match=r"tank\.fmu\.sig: is not a signature of this kind") as refused:
        verify(Path("tank.fmu"), [Path("maker.pub")])
    assert "\n" not in str(refused.value)


def test_keys_are_kept_and_told_apart(here: Path) -> None:
    assert stat.S_IMODE(Path("maker").stat().st_mode) == 0o600
    for path, key, what in (
        ("maker", "maker.pub", "maker.pub: is a public key, which can't sign"),
        ("maker", "tank.fmu", "tank.fmu: no private key can be read from it"),
        ("maker", "none", "none: can't be read: No such file"),
    ):
        with pytest.raises(SignatureError, match=what):
            sign(Path(path), Path(key))
    for key, what in (("maker", "maker: is a private key"), ("tank.fmu", "tank.fmu: no public key can be read")):
        with pytest.raises(SignatureError, match=what):
            verify(Path("tank.fmu"), [Path(key)])
    with pytest.raises(SignatureError, match="maker already exists"):
        new_key(Path("maker"))
    Path("maker").rename("moved")
    with pytest.raises(SignatureError, match=r"maker\.pub already exists"):
        new_key(Path("maker"))


def test_an_encrypted_key_needs_its_passphrase(here: Path) -> None:
    new_key(Path("locked"), "open sesame")
    assert b"ENCRYPTED" in Path("locked").read_bytes()
    with pytest.raises(SignatureError, match="locked: no private key can be read from it"):
        sign(Path("tank.fmu"), Path("locked"), lambda: "open barley")
    sign(Path("tank.fmu"), Path("locked"), lambda: "open sesame")
    verify(Path("tank.fmu"), [Path("locked.pub")])


def test_archives_that_could_mean_two_things_are_not_signed(here: Path) -> None:
    with zipfile.ZipFile("two.fmu", "w") as archive:
        archive.writestr("a", "1")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("a", "2")
    with pytest.raises(SignatureError, match=r"two\.fmu: has several members 'a'"):
        sign(Path("two.fmu"), Path("maker"))
    Path("text.fmu").write_text("no archive")
    with pytest.raises(SignatureError, match=r"text\.fmu: can't be read as a zip archive"):
        sign(Path("text.fmu"), Path("maker"))


def test_the_commands(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sign", "tank.fmu", "--new-key", "mine"]) == 0
    lines = said(capsys).splitlines()
    assert lines[0].startswith("mine.pub: SHA256:")
    assert lines[1:] == ["tank.fmu.sig"]
    assert main(["verify", "tank.fmu", "--key", "mine.pub"]) == 0
    assert said(capsys) == f"tank.fmu: signed with mine.pub ({lines[0].split()[1]}), unchanged, 3 members\n"
    assert main(["verify", "tank.fmu", "none.fmu", "--key", "maker.pub"]) == 1
    assert [line.partition(":")[0] for line in said(capsys).splitlines()] == ["tank.fmu", "none.fmu"]
    for wrong in (["sign", "tank.fmu"], ["sign", "--key", "maker"], ["sign", "--key", "maker", "--new-key", "more"]):
        assert main(wrong) == 1
        assert said(capsys).count("\n") == 1


def test_a_run_can_demand_signatures(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy("tank.fmu", "unsigned.fmu")
    run = ["--step", "0.5", "--stop", "1", "--out", "o", "--require-signed", "maker.pub"]
    assert main(["run", "tank.fmu", *run]) == 0
    said(capsys)
    assert main(["run", "unsigned.fmu", *run]) == 1
    assert "unsigned.fmu: is not signed: there is no unsigned.fmu.sig beside it" in said(capsys)
    Path("two.toml").write_text(
        '[components.a]\nfmu = "tank.fmu"\n[components.b]\nfmu = "unsigned.fmu"\n'
        "[run]\nstop_time = 1.0\nstep_size = 0.5\n"
    )
    for command in (["run", "two.toml", *run], ["sweep", "two.toml", "--vary", "a.u=1,2", *run[4:]]):
        assert main(command) == 1
        assert "unsigned.fmu: is not signed" in said(capsys)
    assert main(["run", "two.toml", "--fmu", "b=tank.fmu", *run]) == 0
    assert main(["validate", "unsigned.fmu", "--run", "--require-signed", "maker.pub"]) == 1
    assert "unsigned.fmu: is not signed" in said(capsys)
    for fmu, code in (("tank.fmu", 0), ("unsigned.fmu", 1)):
        pack = ["pack", "two.toml", "--fmu", f"b={fmu}", "--out", "packed.fmu", "--require-signed", "maker.pub"]
        assert main(pack) == code
        assert ("unsigned.fmu: is not signed" in said(capsys)) == bool(code)
    check_signed([Path("tank.fmu")] * 3, [Path("maker.pub")])
    with pytest.raises(SignatureError, match="there is no such file"):
        check_signed([Path("none.fmu")], [Path("maker.pub")])


def test_the_program_starts_without_the_library_of_keys() -> None:
    code = "import sys, cosim.__main__, cosim.signing; print('cryptography' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
