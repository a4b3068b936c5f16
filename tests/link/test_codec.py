"""Bytes to messages: nothing is lost that came, nothing raises, nothing grows."""

import numpy as np
import pytest

from mufly.link import Codec, Encoder, mavlink
from mufly.link.codec import FRAME_MOST, single, text_of, within


def attitude(k=0):
    return mavlink.MAVLink_attitude_message(k, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


@pytest.fixture
def encode():
    return Encoder(1, 1)


def frames(encode, n):
    return [encode(attitude(k)) for k in range(n)]


def test_messages_come_back_as_they_were_sent(encode):
    sent = mavlink.MAVLink_statustext_message(4, text_of("höher"))
    (back,) = Codec().receive(0.0, "a", encode(sent))
    assert back.get_type() == "STATUSTEXT"
    assert (back.get_srcSystem(), back.get_srcComponent()) == (1, 1)


def test_frames_cut_anywhere_are_put_together(encode):
    data = b"".join(frames(encode, 20))
    codec, out = Codec(), []
    for k in range(0, len(data), 7):
        out += codec.receive(0.0, "a", data[k : k + 7])
    assert [m.time_boot_ms for m in out] == list(range(20))


def test_garbage_between_frames_is_skipped_and_counted(encode):
    rng = np.random.default_rng(1)
    codec, out, junk = Codec(), [], 0
    for frame in frames(encode, 50):
        noise = rng.integers(0, 256, rng.integers(0, 40), dtype=np.uint8).tobytes()
        junk += len(noise)
        out += codec.receive(0.0, "a", noise + frame)
    assert [m.time_boot_ms for m in out] == list(range(50))
    assert codec.counts("a").garbage_bytes == junk


def test_a_false_marker_does_not_hold_up_the_frame_behind_it(encode):
    assert len(Codec().receive(0.0, "a", b"\xfd\xff\x00" + encode(attitude()))) == 1


def test_a_damaged_frame_costs_only_itself(encode):
    first, second = frames(encode, 2)
    first = first[:15] + bytes([first[15] ^ 4]) + first[16:]
    out = Codec().receive(0.0, "a", first + second)
    assert [m.time_boot_ms for m in out] == [1]


def test_noise_alone_keeps_memory_flat():
    rng = np.random.default_rng(2)
    codec = Codec()
    for _ in range(300):
        codec.receive(0.0, "a", rng.integers(0, 256, 1000, dtype=np.uint8).tobytes())
        assert len(codec._channels["a"].buffer) <= FRAME_MOST


def test_gaps_are_losses_and_late_packets_are_not(encode):
    sent = frames(encode, 300)
    codec = Codec()
    for k in [*range(10), 12, 11, *range(15, 300)]:
        codec.receive(k / 100, "a", sent[k])
    counts = codec.counts("a")
    assert (counts.lost, counts.reordered, counts.received) == (3, 1, 297)  # 10, 13 and 14 never came
    assert counts.loss == pytest.approx(3 / 300)


def test_a_doubled_packet_is_heard_once(encode):
    codec = Codec()
    for frame in frames(encode, 40):
        assert len(codec.receive(0.0, "a", frame)) == 1
        assert not codec.receive(0.3, "a", frame)
    assert codec.counts("a").duplicates == 40


def test_a_program_started_again_is_heard_at_once():
    codec = Codec()
    for start in (0.0, 1.5, 3.0):  # the same numbers, the same packets, from the same address
        again = Encoder(255, 190)
        assert [len(codec.receive(start + k / 100, "a", again(attitude(k)))) for k in range(5)] == [1] * 5
    assert codec.counts("a").lost == 0


def test_senders_behind_one_peer_are_told_apart():
    one, two = Encoder(1, 1), Encoder(2, 1)
    codec = Codec()
    for k in range(10):
        codec.receive(0.0, "a", one(attitude(k)) + two(attitude(k)))
    counts = codec.counts("a")
    assert (counts.received, counts.lost, counts.duplicates) == (20, 0, 0)


def test_thousands_of_senders_do_not_fill_the_memory():
    codec = Codec()
    for k in range(5000):
        codec.receive(0.0, "a", Encoder(1 + k % 250, 1 + k // 250)(attitude(k)))
    assert len(codec._channels["a"].senders) == 64


def test_thousands_of_peers_do_not_fill_the_memory(encode):
    codec = Codec()
    for k in range(1000):
        codec.receive(0.0, k, b"\xfd\x09")
        assert codec.receive(0.0, "a", encode(attitude()))
    assert len(codec._channels) <= 128


def test_the_first_version_is_read_the_second_is_sent(encode):
    old = mavlink.MAVLink(None, 9, 1)
    data = attitude(7).pack(old, force_mavlink1=True)
    assert data[0] == 0xFE
    assert encode(attitude())[0] == 0xFD
    (back,) = Codec().receive(0.0, "a", data)
    assert back.time_boot_ms == 7


def test_messages_of_other_dialects_are_counted(encode):
    frame = bytearray(encode(attitude()))
    frame[7:10] = (60_000).to_bytes(3, "little")
    codec = Codec()
    assert len(codec.receive(0.0, "a", bytes(frame) + encode(attitude()))) == 1
    assert codec.counts("a").unknown == 1


def test_fields_hold_what_they_can():
    assert single(1e300) != single(1e300)
    assert single(-2.5) == -2.5
    assert within(float("nan"), -5, 5, unknown=3) == 3
    assert within(1e30, -5, 5) == 5
    assert text_of("x" * 49 + "ö") == b"x" * 49
