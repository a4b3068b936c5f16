"""Bytes to messages: nothing is lost that came, nothing raises, nothing grows."""

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.link import (
    FrameDecoder,
    FrameEncoder,
    GlobalOrigin,
    StatusTextAssembler,
    StatusTextSplitter,
    mavlink,
)
from mufly.link.codec import (
    COORDINATE_NOT_GIVEN,
    MAX_FLOAT32,
    MAX_FRAME_BYTES,
    clip_to_integer,
    decode_coordinate,
    encode_text_field,
    parse_global_origin,
    scale_to_integer,
    to_float32,
)


def attitude(k=0):
    return mavlink.MAVLink_attitude_message(k, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


@pytest.fixture
def encode():
    return FrameEncoder(1, 1)


def frames(encode, n):
    return [encode(attitude(k)) for k in range(n)]


def test_messages_come_back_as_they_were_sent(encode):
    sent = mavlink.MAVLink_statustext_message(4, encode_text_field("höher"))
    (back,) = FrameDecoder().decode_bytes(0.0, "a", encode(sent))
    assert back.get_type() == "STATUSTEXT"
    assert (back.get_srcSystem(), back.get_srcComponent()) == (1, 1)


def test_frames_cut_anywhere_are_put_together(encode):
    data = b"".join(frames(encode, 20))
    codec, out = FrameDecoder(), []
    for k in range(0, len(data), 7):
        out += codec.decode_bytes(0.0, "a", data[k : k + 7])
    assert [m.time_boot_ms for m in out] == list(range(20))


def test_garbage_between_frames_is_skipped_and_counted(encode):
    rng = np.random.default_rng(1)
    codec, out, junk = FrameDecoder(), [], 0
    for frame in frames(encode, 50):
        noise = rng.integers(0, 256, rng.integers(0, 40), dtype=np.uint8).tobytes()
        junk += len(noise)
        out += codec.decode_bytes(0.0, "a", noise + frame)
    assert [m.time_boot_ms for m in out] == list(range(50))
    assert codec.packet_counts("a").garbage_bytes == junk


def test_a_false_marker_does_not_hold_up_the_frame_behind_it(encode):
    assert len(FrameDecoder().decode_bytes(0.0, "a", b"\xfd\xff\x00" + encode(attitude()))) == 1


def test_a_damaged_frame_costs_only_itself(encode):
    first, second = frames(encode, 2)
    first = first[:15] + bytes([first[15] ^ 4]) + first[16:]
    out = FrameDecoder().decode_bytes(0.0, "a", first + second)
    assert [m.time_boot_ms for m in out] == [1]


def test_noise_alone_keeps_memory_flat():
    rng = np.random.default_rng(2)
    codec = FrameDecoder()
    for _ in range(300):
        codec.decode_bytes(0.0, "a", rng.integers(0, 256, 1000, dtype=np.uint8).tobytes())
        assert len(codec._channels["a"].buffer) <= MAX_FRAME_BYTES


def test_gaps_are_losses_and_late_packets_are_not(encode):
    sent = frames(encode, 300)
    codec = FrameDecoder()
    for k in [*range(10), 12, 11, *range(15, 300)]:
        codec.decode_bytes(k / 100, "a", sent[k])
    counts = codec.packet_counts("a")
    assert (counts.lost_count, counts.reordered_count, counts.received_count) == (
        3,
        1,
        297,
    )  # 10, 13 and 14 never came
    assert counts.loss_ratio == pytest.approx(3 / 300)


def test_a_doubled_packet_is_heard_once(encode):
    codec = FrameDecoder()
    for frame in frames(encode, 40):
        assert len(codec.decode_bytes(0.0, "a", frame)) == 1
        assert not codec.decode_bytes(0.3, "a", frame)
    assert codec.packet_counts("a").duplicate_count == 40


def test_a_program_started_again_is_heard_at_once():
    codec = FrameDecoder()
    for start in (0.0, 1.5, 3.0):  # the same numbers, the same packets, from the same address
        again = FrameEncoder(255, 190)
        assert [len(codec.decode_bytes(start + k / 100, "a", again(attitude(k)))) for k in range(5)] == [1] * 5
    assert codec.packet_counts("a").lost_count == 0


def test_senders_behind_one_peer_are_told_apart():
    one, two = FrameEncoder(1, 1), FrameEncoder(2, 1)
    codec = FrameDecoder()
    for k in range(10):
        codec.decode_bytes(0.0, "a", one(attitude(k)) + two(attitude(k)))
    counts = codec.packet_counts("a")
    assert (counts.received_count, counts.lost_count, counts.duplicate_count) == (20, 0, 0)


def test_thousands_of_senders_do_not_fill_the_memory():
    codec = FrameDecoder()
    for k in range(5000):
        codec.decode_bytes(0.0, "a", FrameEncoder(1 + k % 250, 1 + k // 250)(attitude(k)))
    assert len(codec._channels["a"].senders) == 64


def test_thousands_of_peers_do_not_fill_the_memory(encode):
    codec = FrameDecoder()
    for k in range(1000):
        codec.decode_bytes(0.0, k, b"\xfd\x09")
        assert codec.decode_bytes(0.0, "a", encode(attitude()))
    assert len(codec._channels) <= 128


def test_the_first_version_is_read_the_second_is_sent(encode):
    old = mavlink.MAVLink(None, 9, 1)
    data = attitude(7).pack(old, force_mavlink1=True)
    assert data[0] == 0xFE
    assert encode(attitude())[0] == 0xFD
    (back,) = FrameDecoder().decode_bytes(0.0, "a", data)
    assert back.time_boot_ms == 7


def test_messages_of_other_dialects_are_counted(encode):
    frame = bytearray(encode(attitude()))
    frame[7:10] = (60_000).to_bytes(3, "little")
    codec = FrameDecoder()
    assert len(codec.decode_bytes(0.0, "a", bytes(frame) + encode(attitude()))) == 1
    assert codec.packet_counts("a").unknown_count == 1
    assert codec.decode_bytes(0.0, "a", bytes(frame)) == []  # at the end of what came
    assert (codec.packet_counts("a").unknown_count, codec.packet_counts("a").garbage_bytes) == (2, 0)
    # With something behind it that begins no frame it was none itself.
    assert len(codec.decode_bytes(0.0, "b", bytes(frame) + b"\x00" + encode(attitude(1)))) == 1
    assert (codec.packet_counts("b").unknown_count, codec.packet_counts("b").garbage_bytes) == (
        0,
        len(frame) + 1,
    )


def test_fields_hold_what_they_can():
    assert to_float32(1e300) != to_float32(1e300)
    assert to_float32(-2.5) == -2.5
    assert clip_to_integer(float("nan"), -5, 5, unknown=3) == 3
    assert clip_to_integer(1e30, -5, 5) == 5
    assert encode_text_field("x" * 49 + "ö") == b"x" * 49


def test_a_number_heard_before_is_the_same_packet_for_a_second_and_then_a_new_one(encode):
    (frame,) = frames(encode, 1)
    codec = FrameDecoder()
    assert len(codec.decode_bytes(500.0, "a", frame)) == 1
    assert not codec.decode_bytes(500.95, "a", frame)
    assert len(codec.decode_bytes(501.05, "a", frame)) == 1  # said anew by a program that was started again
    assert len(FrameDecoder(keep_duplicates=True).decode_bytes(500.0, "a", frame * 3)) == 3


@pytest.mark.parametrize(("number", "lost", "late"), [(31, 30, 0), (192, 191, 0), (200, 0, 0), (230, 0, 1)])
def test_far_ahead_is_lost_far_away_is_started_anew_and_a_little_behind_is_late(encode, number, lost, late):
    """Numbers go round at 256: up to 192 on are taken for losses, up to 31 back for packets that were overtaken."""
    sent = frames(encode, 256)
    codec = FrameDecoder()
    codec.decode_bytes(7.0, "a", sent[0])
    assert len(codec.decode_bytes(7.5, "a", sent[number])) == 1
    counts = codec.packet_counts("a")
    assert (counts.lost_count, counts.reordered_count) == (lost, late)
    assert counts.loss_ratio == pytest.approx(lost / (lost + 2))
    follows = codec.decode_bytes(7.6, "a", sent[(number + 1) % 256] if not late else sent[1])
    assert len(follows) == 1
    assert codec.packet_counts("a").lost_count == lost


def test_what_is_late_was_not_lost_and_what_is_unheard_has_no_loss(encode):
    assert FrameDecoder().packet_counts("nobody").loss_ratio == 0.0
    sent = frames(encode, 40)
    codec = FrameDecoder()
    for k in (0, 20, 5):
        codec.decode_bytes(7.0, "a", sent[k])
    assert codec.packet_counts("a").lost_count == 18
    assert len(codec.decode_bytes(7.0, "a", sent[5])) == 0
    codec.forget_peer("a")
    assert codec.packet_counts("a").received_count == 0


def test_what_is_late_in_the_second_round_is_not_mistaken_for_the_first_round(encode):
    sent = [encode(attitude(k)) for k in range(300)]
    codec = FrameDecoder()
    for k in [*range(266), 276, 271]:  # numbers 10 to 19 of the second round are missing, 15 comes late
        assert len(codec.decode_bytes(0.001 * k, "a", sent[k])) == 1
    counts = codec.packet_counts("a")
    assert (counts.lost_count, counts.reordered_count, counts.duplicate_count) == (9, 1, 0)


def statustext(text, number, piece):
    (message,) = FrameDecoder().decode_bytes(
        0.0, "v", FrameEncoder(1, 1)(mavlink.MAVLink_statustext_message(4, text, number, piece))
    )
    return message


def test_a_line_whose_piece_was_lost_waits_two_seconds_and_ever_new_ones_push_the_oldest_out():
    pieces = StatusTextAssembler()
    full = b"x" * 50
    assert pieces.add_chunk(500.0, statustext(full, 7, 0)) == []
    assert pieces.add_chunk(500.1, statustext(b"end", 7, 2)) == []
    assert pieces.take_overdue(501.9) == []
    assert pieces.take_overdue(502.1) == [(4, "x" * 50 + "..." + "end")]
    for number in range(1, 9):
        assert pieces.add_chunk(600.0, statustext(full, number, 0)) == []
    assert pieces.add_chunk(600.0, statustext(full, 9, 0)) == [(4, "x" * 50 + "...")]
    assert pieces.add_chunk(600.0, statustext(b"", 2, 1)) == [(4, "x" * 50)]
    assert len(pieces.take_overdue(602.5)) == 7


def test_places_that_do_not_fit_are_not_given_and_numbers_go_round():
    assert scale_to_integer(47.3769, 1e7) == 473_769_000
    assert decode_coordinate(473_769_000, 1e-7) == pytest.approx(47.3769)
    for number in (1e3, -1e3, float("nan"), float("inf")):
        assert scale_to_integer(number, 1e7) == COORDINATE_NOT_GIVEN
    assert np.isnan(decode_coordinate(COORDINATE_NOT_GIVEN, 1e-7))
    assert clip_to_integer(-7.6, -5, 5) == -5
    assert to_float32(MAX_FLOAT32) == MAX_FLOAT32
    texts = StatusTextSplitter()
    texts._last_id = 65534
    ids = [texts("long " * 20)[0].id for _ in range(3)]
    assert ids == [65535, 1, 2]


@pytest.mark.parametrize(("lat", "alt"), [(0.0, 0.0), (47.3769, 408.0), (-80.0, 4000.0)])
def test_metres_of_a_degree_are_those_of_the_ellipsoid(lat, alt):
    """Against the exact way: geodetic to earth-centred coordinates and into the plane (Groves, Sec. 2.4)."""
    a, f = 6_378_137.0, 1.0 / 298.257223563
    e2 = f * (2.0 - f)

    def centred(lat_deg, lon_deg, height):
        phi, lam = np.radians([lat_deg, lon_deg])
        n = a / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
        across = (n + height) * np.cos(phi)
        return np.array([across * np.cos(lam), across * np.sin(lam), (n * (1.0 - e2) + height) * np.sin(phi)])

    origin, phi, lam = GlobalOrigin(lat, 8.5, alt), np.radians(lat), np.radians(8.5)
    north = [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)]
    place = origin.to_global(60.0, -40.0, -5.0)
    away = centred(*place) - centred(lat, 8.5, alt)
    tilt = 40.0**2 / 6e6 * abs(np.tan(phi)) + 1e-3  # what the plane leaves out
    assert np.dot(away, north) == pytest.approx(60.0, abs=tilt)
    assert np.dot(away, [-np.sin(lam), np.cos(lam), 0.0]) == pytest.approx(-40.0, abs=2 * tilt)
    assert place[2] == pytest.approx(alt + 5.0)
    assert origin.to_local(*place) == pytest.approx((60.0, -40.0, -5.0))
    assert origin.to_local(place[0], place[1], 5.0, 3) == pytest.approx((60.0, -40.0, -5.0))
    assert np.isnan(origin.to_local(lat, float("nan"), alt)[1])


def test_origins_are_read_and_what_is_none_is_refused():
    assert parse_global_origin("-85,180,9000") == GlobalOrigin(-85.0, 180.0, 9000.0)
    assert parse_global_origin("0,-180,-500").alt_m == -500.0
    for text in ("1,2", "a,b,c", "nan,0,0", "85.1,0,0", "0,180.1,0", "0,0,-501", "0,0,9001"):
        with pytest.raises(InputError, match="origin"):
            parse_global_origin(text)
