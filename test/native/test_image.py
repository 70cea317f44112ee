"""Images of memory: addresses become fixups wherever they lie, and what leads nowhere is refused."""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.native.image import CONSTANT, KERNEL, WRITTEN, Fixup, Image


def test_a_known_address_is_found_in_low_memory_too():
    table = np.array([3, 0x4F2B30, 7], np.int64)
    image = Image([table], [np.ones(2)], [], {0x4F2B30: 5})
    assert image.fixups == [Fixup(CONSTANT, 8, KERNEL, 5)]
    assert image.sections[CONSTANT].view(np.int64)[:3].tolist() == [3, 0, 7]


@pytest.mark.parametrize('address', [1 << 32, 0x7F0000001000, -(1 << 40)])
def test_an_address_that_leads_nowhere_is_refused(address):
    with pytest.raises(TypeError, match='neither a kernel nor a table'):
        Image([np.array([address], np.int64)], [], [], {})


def test_arrays_that_share_memory_share_it_in_the_image_and_no_step_writes_into_tables():
    whole = np.arange(6.0)
    image = Image([], [whole[2:], whole[:4]], [], {})
    assert image.place(whole[2:]) == (WRITTEN, 16) and image.place(whole[:4]) == (WRITTEN, 0)
    np.testing.assert_array_equal(image.sections[WRITTEN].view(float)[:6], whole)
    with pytest.raises(TypeError, match='a step writes into memory of the tables'):
        Image([whole[:4]], [whole[2:]], [], {})
