import os
from pathlib import Path

import pytest
from shared import cases

from bullet_lab.simulation.world.xml import (
    ElementReader,
    XmlError,
    numbers,
    parse_text,
    read_text,
)

LAUGHS = "".join(
    f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' if i else '<!ENTITY l0 "ha">' for i in range(10)
)


def one_line(caught):
    return "\n" not in str(caught.value) and str(caught.value)


@cases(r"""
text:
  - ""
  - <a></b>
  - <a/><b/>
  - "<a>\u0000</a>"
""")
def test_malformed_xml_is_refused_by_name(text):
    with pytest.raises(XmlError, match="^here: not well-formed XML: ") as caught:
        parse_text(text, "here")
    assert one_line(caught)


@pytest.mark.parametrize(
    "prolog",
    [
        "<!DOCTYPE a>",
        "<!-- -- --><!DOCTYPE a>",
        '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE a [<!ENTITY % x SYSTEM "file:///etc/passwd"> %x;]>',
        f"<!DOCTYPE a [{LAUGHS}]>",
    ],
)
def test_document_types_and_entities_are_refused(prolog):
    with pytest.raises(XmlError, match="^here: document types and entities are refused$"):
        parse_text(f"{prolog}<a>&x;&l9;</a>", "here")


@cases(r"""
text:
  - "<!-- licence -->\n<?xml version='1.0'?>\n<a><b/></a>"
  - <a><!-- 1 -- 2 --><!-- <b> ---><b/></a>
  - <a xmlns:c='d'><b/><e:f g='1'/></a>
  - <a h:g='1'><b/></a>
""")
def test_what_gazebos_parser_passes_over_is_passed_over(text):
    assert parse_text(text, "here").find("b") is not None


def test_values_without_quotes():
    found = parse_text("<a c=1 d='e f=g'\nh = i/j><b k=l/></a>", "here")
    assert found.attrib == {"c": "1", "d": "e f=g", "h": "i/j"}
    assert found.find("b").attrib == {"k": "l"}


def test_lines_keep_their_numbers():
    text = "<!-- a\nb -- c -->\n<?xml version='1.0'\n?>\n<a>\n<b></a>"
    with pytest.raises(XmlError, match="mismatched tag: line 6"):
        parse_text(text, "here")


@cases("encoding: [UTF-8, utf-7, UTF-16, klingon]")
def test_the_declared_encoding_of_a_text_does_not_matter(encoding):
    text = f'<?xml version="1.0" encoding="{encoding}"?><a n="+ADw-ü"/>'
    assert parse_text(text, "here").get("n") == "+ADw-ü"


def test_half_a_surrogate_is_refused():
    with pytest.raises(XmlError, match="^here: not Unicode text$"):
        parse_text("<a>\ud800</a>", "here")


def test_a_huge_text_is_refused(tmp_path):
    most, path = 20_000_000, tmp_path / "huge"
    path.touch()
    os.truncate(path, most)
    text = read_text(path)
    assert len(text) == most
    with pytest.raises(XmlError, match="^here: larger than 20000000 bytes$"):
        parse_text(text + " ", "here")
    os.truncate(path, most + 1)
    with pytest.raises(XmlError, match="huge: larger than 20000000 bytes$"):
        read_text(path)


def test_nobody_is_waited_for_where_a_file_should_be(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), Path("/dev/tty")):
        with pytest.raises(XmlError, match=f"^{path}: (not a file|No such device.*)$"):
            read_text(path)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(XmlError, match="nix: No such file"):
        read_text(tmp_path / "nix")
    with pytest.raises(XmlError, match="Is a directory"):
        read_text(tmp_path)
    (tmp_path / "latin").write_bytes("ü".encode("latin-1"))
    with pytest.raises(XmlError, match="latin: not UTF-8 text$"):
        read_text(tmp_path / "latin")


@cases("text: [null, 1 2, 1 2 3 4, 1 2 x, 1 inf 2]")
def test_wrong_numbers_are_quoted(text):
    shown = text or ""
    with pytest.raises(XmlError, match=f"^place: '{shown}' is not 3 finite numbers$"):
        numbers(text, 3, "place")


def said(text):
    return ElementReader(parse_text(f"<a><x>{text}</x></a>", "a"), "a")


def test_text_and_boolean():
    reader = ElementReader(parse_text("<a><b> x </b><c/></a>", "here"), "here")
    assert [reader.text(tag, "no") for tag in "bcd"] == ["x", "no", "no"]
    texts = ("true", "1", " True ", "false", "0", "")
    assert [said(text).boolean("x", False) for text in texts] == [True] * 3 + [False] * 3
    with pytest.raises(XmlError, match="^a: <x>: 'yes' is not true or false$"):
        said("yes").boolean("x", True)
