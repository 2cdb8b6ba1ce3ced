"""Devices by what they are made of: a pad's events in a file, a keyboard's keys in a pipe; and the watch over them."""

import os
import struct

import numpy as np
import pytest

from jaxik.teleoperation import GamePad, Hand, Keyboard, RecordedHand, Watchdog


def event(value, kind, number):
    """An event as in linux/joystick.h: time [ms], value, kind, number."""
    return struct.pack("=IhBB", 12, value, kind, number)


def test_a_game_pad_is_its_sticks(tmp_path):
    """Fully out is its reach; the first events, which tell the state as it was, have another bit."""
    file = tmp_path / "js0"
    file.write_bytes(event(32767, 0x82, 0) + event(-16384, 2, 1) + event(32767, 2, 3) + event(9, 2, 7) + event(1, 1, 0))
    pad = GamePad(file, reach=0.05, turning=0.4)
    hand = pad.read()
    np.testing.assert_allclose(hand.position, [0.05, 0.025, 0.0], atol=1e-5)
    np.testing.assert_allclose(hand.turn, [0.0, 0.0, -0.4])
    assert hand.buttons.tolist() == [1.0]
    np.testing.assert_array_equal(pad.read().position, hand.position)  # nothing new is as before
    watch = Watchdog(pad)
    assert watch.read().age == 0.0
    watch.close()
    assert watch.read().age > 0.0  # gone
    with pytest.raises(OSError):
        GamePad(tmp_path / "js1")


def test_a_keyboard_goes_in_steps():
    ends, now = os.pipe(), [0.0]
    with os.fdopen(ends[0]) as stream, os.fdopen(ends[1], "wb", buffering=0) as keys:
        board = Keyboard(stream, step=0.002, turning=0.3, held=0.1, clock=lambda: now[0])
        assert not board.read().position.any()
        keys.write(b"wwdf?u ")
        hand = board.read()
        np.testing.assert_allclose(hand.position, [0.002, 0.004, -0.002])
        np.testing.assert_allclose(hand.turn, [0.0, 0.0, 0.3])
        assert hand.buttons.tolist() == [1.0]
        now[0] = 0.2
        keys.write(b" s")
        hand = board.read()
        assert not hand.turn.any() and not hand.buttons.any() and hand.position[1] == pytest.approx(0.002)
        board.close()


def test_a_watch_tells_how_long_nothing_was_said():
    hand, now = Hand(np.ones(3)), [5.0]
    watch = Watchdog(RecordedHand([None, hand, None, hand]), clock=lambda: now[0])
    assert watch.read().age == np.inf
    assert (watch.read().position == 1.0).all()
    now[0] = 5.4
    late = watch.read()
    assert late.age == pytest.approx(0.4) and (late.position == 1.0).all()
    assert watch.read().age == 0.0
    slow = Watchdog(RecordedHand([hand._replace(age=0.3), None]), clock=lambda: now[0])  # over a network, say
    assert slow.read().age == pytest.approx(0.3)
    now[0] = 5.5
    assert slow.read().age == pytest.approx(0.4)
    now[0] = 0.0  # a clock that is set back tells nothing
    assert slow.read().age == np.inf
    watch.render(np.zeros(3))
