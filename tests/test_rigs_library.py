"""Which rig description is meant, and what is said when there is none."""

import json
from pathlib import Path

import pytest

import rigs
from rigs.errors import DescriptionError
from rigs.library import MAX_BYTES, find_description, schema, schema_text, shipped_rigs, user_description_path

RIGS = Path(rigs.__file__).parent


@pytest.fixture(autouse=True)
def bare_bench(tmp_path, monkeypatch):
    """An empty working folder, an empty home, no RIG."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.delenv("RIG", raising=False)
    for name in ("HOME", "XDG_CONFIG_HOME", "APPDATA", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(tmp_path / "home"))


def write_rig(path: Path, name: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(shipped_rigs()["simulated"].replace("name: simulated", f"name: {name}"), encoding="utf-8")
    return path


def test_the_simulated_rig_is_the_default_and_says_so():
    found = find_description(None)
    assert (found.description.name, found.how, found.where) == ("simulated", "default", "simulated.yaml (shipped)")


def test_the_nearest_description_is_taken(monkeypatch):
    write_rig(user_description_path(), "home")
    assert (find_description(None).description.name, find_description(None).how) == ("home", "user's config folder")
    write_rig(Path("rig.yaml"), "here")
    assert (find_description(None).description.name, find_description(None).how) == ("here", "./rig.yaml")
    monkeypatch.setenv("RIG", str(write_rig(Path("env.yaml"), "env")))
    assert (find_description(None).description.name, find_description(None).how) == ("env", "RIG")
    argument = str(write_rig(Path("argument.yaml"), "argument"))
    assert (find_description(argument).description.name, find_description(argument).how) == ("argument", "--rig")


def test_an_empty_RIG_is_no_RIG(monkeypatch):
    monkeypatch.setenv("RIG", "")
    assert find_description(None).how == "default"


def test_a_shipped_rig_is_named_bare_and_a_file_of_that_name_by_its_path():
    write_rig(Path("kinect8"), "mine")
    assert find_description("kinect8").description.name == "kinect8"
    assert find_description("./kinect8").description.name == "mine"


def test_the_text_is_kept_word_for_word():
    assert find_description("bench8").text == (RIGS / "bench8.yaml").read_text(encoding="utf-8")


def test_a_broken_rig_yaml_is_named_not_passed_over():
    Path("rig.yaml").write_text("name: [", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"^rig\.yaml, line 1"):
        find_description(None)


@pytest.mark.parametrize(("how", "name"), [("--rig", "nowhere.yaml"), ("RIG", "kinect9")])
def test_a_missing_file_is_answered_with_the_shipped_rigs(monkeypatch, how, name):
    monkeypatch.setenv("RIG", name)
    with pytest.raises(
        DescriptionError, match=f"{name}: no such rig description .named by {how}.*bench8, kinect8"
    ) as caught:
        find_description(name if how == "--rig" else None)
    assert caught.value.exit_code == 2


def test_a_folder_is_not_a_description(tmp_path):
    with pytest.raises(DescriptionError, match="cannot be read"):
        find_description(str(tmp_path))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"#" * (MAX_BYTES + 1), "larger than 1 MB"),
        (b"\x89HDF\r\n\x1a\n", "not UTF-8 text"),
        (b"", "not a rig description"),
        ("name: ä".encode("utf-16"), "not UTF-8 text"),
    ],
)
def test_a_foreign_file_is_refused(content, said):
    Path("foreign").write_bytes(content)
    with pytest.raises(DescriptionError, match=f"^foreign: .*{said}"):
        find_description("foreign")


def test_a_byte_order_mark_of_a_windows_editor_does_no_harm():
    Path("bom.yaml").write_text(shipped_rigs()["simulated"], encoding="utf-8-sig")
    assert find_description("bom.yaml").description.name == "simulated"


def test_the_schema_file_is_current():
    assert (RIGS / "rig.schema.json").read_text(encoding="utf-8") == schema_text(), (
        'write it anew: python -c "from rigs.library import schema_text; '
        "open('rigs/rig.schema.json', 'w', encoding='utf-8').write(schema_text())\""
    )


def test_the_schema_refuses_unknown_keys_and_knows_the_sections():
    document = json.loads(schema_text())
    assert document == schema()
    assert document["additionalProperties"] is False
    assert {"audio", "camera", "board", "trigger", "signal", "medium"} <= set(document["required"])
