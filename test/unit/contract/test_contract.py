"""The package's contract: its files are valid, and cover everything that the bridge offers."""

import re
from xml.etree import ElementTree

import pytest
from contract_judges import JUDGES
from contract_program import (
    ContractParameters,
    deviations_table,
    listing,
    read_command,
    table,
    write_junit,
)
from contract_rows import ContractError, Deviation, Row, read_contract
from contract_run import (
    DEVIATES,
    FAILED,
    NOT_JUDGED,
    PASSED,
    Verdict,
    floor_text,
    places,
    verdict,
)
from shared import PACKAGE, cases, refuses

from bullet_lab.simulation.plugins import known_plugins

FOLDER = PACKAGE / "test" / "contract" / "rows"
CONTRACT = read_contract(FOLDER)
PROBES = [probe for chapter in CONTRACT.chapters for probe in chapter.probes.values()]
SOURCE = re.compile(r"gazebo_(ros|plugins|ros_control)/[\w/]+\.(cpp|h):\d+(,\d+)*")
# Tags of this simulation only, or ignored tags; see the pages of the plugins.
OWN_TAGS = re.compile(
    "samples|exposure|blur|supportRadius|(left|right)WheelDiameter|alwaysOn|visualize|"
    "rosDebugLevel|legacyMode|triggerTopicName|reduceNormals|normalsTopicName|"
    "reflectanceTopicName|autoDistortion|borderCrop"
)
TAG_ROW = re.compile(r"^\| `([^|]*)` \|", re.MULTILINE)


# Of other packages than gazebo_ros_pkgs, or not in the contract: test/unit/simulation/plugins
# compares them with closed forms.
WITHOUT_ROWS = re.compile("velodyne|block_laser|multicamera|triggered|kobuki|tricycle|force_based")


PLUGINS = [
    name
    for name in known_plugins()
    if name.startswith("libgazebo_ros_") and not WITHOUT_ROWS.search(name)
]


def test_each_row_names_a_line_of_gazebo_ros_pkgs():
    assert [row.name for row in CONTRACT.rows if not SOURCE.fullmatch(row.source)] == []


def test_each_word_is_used():
    assert {row.word for row in CONTRACT.rows} == set(JUDGES)


def test_each_probe_is_a_model_with_its_plugin():
    for probe in PROBES:
        (plugin,) = ElementTree.fromstring(probe.text(FOLDER)).iter("plugin")
        assert plugin.get("filename") == probe.plugin, probe.name
        assert {entry.tag for entry in plugin} == set(probe.tags), probe.name


def test_probes_stand_apart_and_on_the_floor():
    where = places(probe.name for probe in PROBES)
    assert len(set(where.values())) == len(PROBES)
    floor = ElementTree.fromstring(floor_text(list(where.values())))
    assert len(list(floor.iter("collision"))) == len(PROBES)


@pytest.mark.parametrize("plugin", PLUGINS)
def test_each_plugin_has_a_probe_with_and_one_without_each_of_its_tags(plugin):
    own = [probe for probe in PROBES if probe.plugin == plugin]
    pages = [path.read_text() for path in (PACKAGE / "docs" / "plugins").glob("*.md")]
    page = next(page for page in pages if plugin in page.split("\n", 1)[0])
    cells = ",".join(TAG_ROW.findall(re.split("Passed over|Ignored", page)[0]))
    tags = {tag.strip(" `") for tag in re.split(r",| … ", cells)}
    for tag in tags:
        if OWN_TAGS.fullmatch(tag) or not re.fullmatch(r"[a-zA-Z]\w\w+", tag):
            continue
        # A namespace comes from the spawn service, too.
        if tag != "robotNamespace" and not is_of_another(tag, page, plugin):
            assert any(tag in probe.tags for probe in own), tag
        assert any(tag not in probe.tags for probe in own), tag


def is_of_another(tag, page, plugin):
    """Whether a page of several plugins has a tag for another one of them."""
    found = re.search(rf"`{tag}`.*\|.*`(imu|imu_sensor)`", page)
    return found and plugin != f"libgazebo_ros_{found[1]}.so"


def test_each_deviation_has_a_reason():
    assert [entry.rows for entry in CONTRACT.deviations if len(entry.reason) <= 15] == []


def test_the_page_has_the_deviations():
    assert deviations_table(CONTRACT) in (PACKAGE / "docs" / "gazebo_contract.md").read_text()


ROW = Row("chapter/row", "gazebo_ros/a.cpp:1", "rate")
KNOWN = Deviation(("chapter/row",), "it is better so", {"rate": 1})


@cases("""
complaint, known, instead, status:
  - ["", null, "", passed]
  - [2 Hz, null, "", FAILED]
  - [2 Hz, true, "", deviates]
  - [2 Hz, true, 2 Hz, FAILED]
  - ["", true, "", FAILED]
""")
def test_a_row_holds_unless_it_is_known_to_deviate(complaint, known, instead, status):
    assert verdict(ROW, complaint, known and KNOWN, instead).status == status


def test_table_listing_and_junit_have_each_row(tmp_path):
    found = {PASSED: "", FAILED: "2 Hz", DEVIATES: "so", NOT_JUDGED: "it died"}
    verdicts = [Verdict(ROW, *each) for each in found.items()]
    lines = table(verdicts).splitlines()
    assert "a.cpp:1  2 Hz" in lines[1]
    assert lines[4].startswith("1 passed, 1 deviates, 1 FAILED, 1 not judged")
    assert "it is better so" in listing([ROW], {ROW.name: KNOWN})
    write_junit(tmp_path / "a.xml", verdicts, 1.5)
    suite = ElementTree.parse(tmp_path / "a.xml").getroot()
    counts = [suite.get(key) for key in ("tests", "failures", "skipped", "errors")]
    assert counts == ["4", "1", "1", "1"]
    assert suite.find("testcase/failure").get("message") == "2 Hz"


def test_options_are_the_declared_parameters():
    assert read_command(["--only", "imu", "--list"]) == ContractParameters(only="imu", list=True)


@cases(r"""
text, message:
  - ["rows: 3", no rows]
  - ["rows: [{name: a, line: 1}]", needs exactly one of]
  - ["rows: [{name: a, line: 1, rate: 1, tf: [a, b]}]", needs exactly one of]
  - ["rows: [{name: a, rate: 1}]", no line]
  - ["rows: [{name: a, line: 1, probe: b, rate: 1}]", no probe 'b']
  - ["rows: [{name: a, line: 1, rate: 1}, {name: a, line: 1, rate: 1}]", duplicate rows]
  - ["probes: {a: {robot: b, colour: red}}\nrows: []", colour]
  - ["rows: [", while parsing]
""")
def test_an_invalid_contract_is_refused(tmp_path, text, message):
    (tmp_path / "bad.yaml").write_text(text)
    with refuses(message, ContractError):
        read_contract(tmp_path)


def test_an_empty_folder_is_no_contract(tmp_path):
    with refuses("no contract", ContractError):
        read_contract(tmp_path)
