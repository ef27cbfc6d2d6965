"""Which outlines each pass of the search finds."""

import numpy as np
import pytest

from bullet_lab.vision.candidates import CandidateSearch


@pytest.mark.parametrize("weak, found", [(20, False), (80, True)])
def test_much_texture_hides_weak_edges_in_the_first_pass_only(weak, found):
    grey = np.full((200, 200), 120, np.uint8)
    grey[:, 100:] = np.where(np.indices((200, 100)).sum(axis=0) // 4 % 2, 200, 40)
    grey[60:90, 30:60] = 120 - weak
    search = CandidateSearch(grey, 8.0)
    left = lambda quads: bool((quads.max(axis=(1, 2)) < 95.0).any())  # noqa: E731
    assert left(search.first_pass(7.0)) == found
    assert left(search.second_pass(7.0))
