"""Messages for users: one line, of a length that can be read, whatever they quote."""

from shared import cases

from bullet_lab.errors import LabError


@cases(f"""
message, line:
  - [std is -1, std is -1]
  - ["a\\nb\\t c", a b c]
  - ["id is {10_000 * "9"}: no id", "id is {150 * "9"}…{149 * "9"}: no id"]
  - [{399 * "x"}, {399 * "x"}]
""")
def test_a_message_is_one_line(message, line):
    assert str(LabError(message)) == line


def test_a_message_of_many_words_ends():
    assert len(str(LabError(100_000 * "ab "))) < 2100
