"""Whatever bytes a file holds: it is read as far as it is sound, or refused in one line. No other exception."""

import gzip
import json
import math
import re
import struct
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from mufly.errors import InputError
from mufly.logs import LOG_WRITERS, LogWarning, examine_log, read_log, read_raw_log, read_recording, write_log


def survives(path):
    """Read and examine; True if it worked, False if it was refused in one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        worked = True
        for look in (read_log, examine_log):
            try:
                look(path)
            except InputError as error:
                assert "\n" not in str(error)  # noqa: PT017
                worked = False
    return worked


@pytest.fixture(scope="session")
def samples(tmp_path_factory, make_signals, make_dataflash, make_micro_sd, mavlink):
    folder = tmp_path_factory.mktemp("samples")
    out = {e: write_log(make_signals(n=60), folder / f"log{e}").read_bytes() for e in LOG_WRITERS}
    rows = [(20_000 * k, 100 * k, -50, 9000, 0.1 * k) for k in range(1, 60)]
    units = {"labels": {"d": "deg", "s": "s"}, "ids": {"ATT": "sddd-"}}
    out[".bin"] = make_dataflash([(10, "ATT", "QcccF".replace("F", "f"), "TimeUS,Roll,Pitch,Yaw,X", rows)], units)
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out[".tlog"] = b"".join(
        int(1.7e15 + 1e5 * k).to_bytes(8, "big") + link.attitude_encode(100 * k + 5, 0.01 * k, 0, 0, 0, 0, 0).pack(link)
        for k in range(60)
    )
    by_events, of_2018 = make_micro_sd
    kinds = {0: ("fixedFrequency", ["gyro.x(f)", "gyro.y(f)", "gyro.z(f)"]), 3: ("estTDOA", ["id(B)"])}
    out[".usd"] = by_events(kinds, [(0, 0.01 * k, (k, 1, 2)) for k in range(60)] + [(3, 0.6, (1,))])
    out[".usd of 2018"] = of_2018(["tick(I)", "pm.vbat(f)"], [(10 * k, 0.05 * k) for k in range(60)])
    return folder, out


KINDS = [*LOG_WRITERS, ".bin", ".tlog", ".usd", ".usd of 2018"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_samples_are_sound(samples, kind):
    folder, contents = samples
    path = folder / "whole"
    path.write_bytes(contents[kind])
    assert survives(path)


@settings(max_examples=150)
@given(st.sampled_from(KINDS), st.data())
def test_damaged_files_are_read_or_refused(samples, kind, draw):
    folder, contents = samples
    content = bytearray(contents[kind])
    for _ in range(draw.draw(st.integers(1, 6))):
        content[draw.draw(st.integers(0, len(content) - 1))] = draw.draw(st.integers(0, 255))
    path = folder / "damaged"
    path.write_bytes(content[: draw.draw(st.integers(len(content) // 3, len(content)))])
    survives(path)


HEADS = [b"", b"ULog\x01\x12\x35\x01", b"\xa3\x95\x80\x59", b"PAR1", b"CDF\x01", b"\x89MCAP0\r\n", b"FMT, "]
HEADS += [b"\xbc\x02\x00\x01\x00\x00\x00a\x00\x01\x00x(f)\x00", b"\x02tick(I),x(f),", b"\x1f\x8b\x08"]


@settings(max_examples=40)
@given(st.binary(min_size=1, max_size=300), st.sampled_from(HEADS))
def test_noise_is_read_or_refused(tmp_path_factory, content, head):
    path = tmp_path_factory.mktemp("noise") / "noise"
    path.write_bytes(head + content)
    survives(path)


def test_text_of_any_kind_is_read_or_refused(tmp_path):
    rng = np.random.default_rng(3)
    letters = list("0123456789.,;:\t -eE#%[]()\"'\nabtNü")
    path = tmp_path / "text.csv"
    for _ in range(150):
        path.write_text("".join(rng.choice(letters, size=rng.integers(3, 200))))
        survives(path)


def foreign_mcap(path, compression=CompressionType.NONE, **options):
    """600 messages, 10 ms apart, in chunks of some 50; the numbers of each tell where it stood."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=4096, **options)
        writer.start(library="of somebody else")
        schema = writer.register_schema("imu", "jsonschema", b"{}")
        channel = writer.register_channel("/imu", "json", schema)
        for k in range(600):
            at = 1_700_000_000_000_000_000 + 10_000_000 * k
            writer.add_message(channel, at, json.dumps({"roll": k / 7, "seq": k}).encode(), at, k)
        writer.finish()
    return bytearray(path.read_bytes())


def records_of(content):
    """Offset, opcode and length of every record beside the chunks."""
    at = 8
    while at + 9 <= len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        yield at, opcode, length
        at += 9 + length


def imu(path, content):
    path.write_bytes(content)
    raw = read_raw_log(path)
    seq = raw["/imu"].fields["seq"]
    assert (raw["/imu"].fields["roll"] == seq / 7).all()
    return raw, seq


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_damaged_chunk_costs_its_own_messages_alone(tmp_path, compression):
    content = foreign_mcap(tmp_path / "a.mcap", compression)
    chunks = [(at, length) for at, opcode, length in records_of(content) if opcode == Opcode.CHUNK]
    raw, seq = imu(tmp_path / "a.mcap", content)
    assert raw.is_complete
    assert len(seq) == 600
    at, length = chunks[3]
    content[at + 9 + length // 2 : at + 9 + length // 2 + 8] = b"\xff" * 8
    raw, seq = imu(tmp_path / "a.mcap", content)
    gone = np.setdiff1d(np.arange(600), seq)
    assert 40 < len(gone) < 70
    assert np.ptp(gone) == len(gone) - 1
    (said,) = raw.describe_damage()
    assert f"{len(gone)} messages from {gone[0] / 100:.2f} to {gone[-1] / 100:.2f} s are missing" in said
    assert f"{len(seq)} of 600 messages are in the file" in said
    content[at + 1 : at + 9] = b"\xff" * 8  # its length leads nowhere: the index knows the next
    assert np.array_equal(imu(tmp_path / "a.mcap", content)[1], seq)
    content = content[: chunks[8][0]]  # no index any more: the next chunk is found by its looks
    raw, seq = imu(tmp_path / "a.mcap", content)
    assert not raw.is_complete
    assert np.array_equal(np.setdiff1d(np.arange(seq[-1] + 1), seq), gone)


def test_records_outside_chunks_are_found_again(tmp_path):
    content = foreign_mcap(tmp_path / "a.mcap", use_chunking=False)
    places = [at for at, opcode, _ in records_of(content) if opcode == Opcode.MESSAGE]
    content[places[100] + 1 : places[100] + 9] = b"\xff" * 8
    content[places[200] + 40] = 0xFF  # its text is no JSON any more
    raw, seq = imu(tmp_path / "a.mcap", content)
    assert np.setdiff1d(np.arange(600), seq).tolist() == [100, 200]
    assert "599 of 600 messages are in the file" in raw.damage_text
    assert raw.notes == ("/imu: 1 of 599 messages are not JSON and are skipped",)


def test_an_index_that_is_damaged_costs_nothing(tmp_path):
    whole = foreign_mcap(tmp_path / "a.mcap")
    summary = [(at, length) for at, opcode, length in records_of(whole) if opcode == Opcode.CHUNK_INDEX]
    for offset in (9, 20, 1):
        content = whole.copy()
        content[summary[2][0] + offset] ^= 0xFF
        raw, seq = imu(tmp_path / "a.mcap", content)
        assert len(seq) == 600
        assert raw.damage_text == "the index at the end is damaged"
    content = whole.copy()
    at = next(at for at, opcode, _ in records_of(whole) if opcode == Opcode.DATA_END)
    content[at] = 0  # the record between data and index
    raw, seq = imu(tmp_path / "a.mcap", content)
    assert len(seq) == 600
    assert f"13 bytes at byte {at} are damaged" in raw.damage_text


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_cut_chunk_keeps_the_messages_before_the_cut(tmp_path, compression):
    content = foreign_mcap(tmp_path / "a.mcap", compression)
    chunks = [(at, length) for at, opcode, length in records_of(content) if opcode == Opcode.CHUNK]
    at, length = chunks[5]
    before = len(imu(tmp_path / "a.mcap", content[:at])[1])
    raw, seq = imu(tmp_path / "a.mcap", content[: at + 9 + length * 2 // 3])
    assert np.array_equal(seq, np.arange(len(seq)))
    words = f"the file ends inside a chunk, {9 + length * 2 // 3} of {9 + length} bytes of it are there"
    assert f"at byte {at} {words}" in raw.damage_text
    assert "it has no end mark" in raw.damage_text
    if compression is CompressionType.NONE:
        assert len(seq) > before + 20
        assert f"with {len(seq) - before} complete messages" in raw.damage_text


def test_what_stands_behind_the_end_mark_is_told(tmp_path):
    content = foreign_mcap(tmp_path / "a.mcap")
    for behind in (bytes(5000), b"garbage"):
        raw, seq = imu(tmp_path / "a.mcap", content + behind)
        assert len(seq) == 600
        assert raw.damage_text == f"{len(behind)} bytes after the end mark do not belong to the file"
    raw, seq = imu(tmp_path / "a.mcap", content[:30_000] + bytes(len(content) - 30_000))
    assert not raw.is_complete
    assert 200 < len(seq) < 400


def test_a_packing_that_is_not_known_is_refused_by_its_name(tmp_path):
    content = foreign_mcap(tmp_path / "a.mcap", CompressionType.ZSTD)
    path = tmp_path / "a.mcap"
    path.write_bytes(content.replace(b"\x04\x00\x00\x00zstd", b"\x04\x00\x00\x00lzma"))
    with pytest.raises(InputError, match="packed by 'lzma', which is not read here; repack it: mcap compress"):
        read_raw_log(path)


def test_a_recording_cut_at_any_byte_of_its_last_block_keeps_every_whole_row(tmp_path, make_signals, monkeypatch):
    monkeypatch.setattr("mufly.logs.mcap_recording._BLOCK_ROWS", 50)
    data = make_signals(n=60).drop_vars(["flap", "measured_rates"])
    path = tmp_path / "flight.mcap"
    content = write_log(data, path).read_bytes()
    chunks = [at for at, opcode, _ in records_of(content) if opcode == Opcode.CHUNK]
    assert len(chunks) == 2
    for end in [*range(chunks[-1], len(content), 37), *range(len(content) - 40, len(content))]:
        path.write_bytes(content[:end])
        with pytest.warns(LogWarning, match=r"is damaged, cut off or still being written.*no end mark"):
            back = read_recording(path)
        n = back.sizes["time"]
        assert n >= 50
        assert back.attrs["complete"] is False
        assert np.array_equal(back.measured_attitude, data.measured_attitude[:n])
    damaged = bytearray(content)
    damaged[chunks[0] + 500] ^= 1
    path.write_bytes(damaged)
    with pytest.warns(LogWarning, match=r"messages from 0\.00 to 0\.98 s are missing"):
        back = read_recording(path)
    assert back.time.values.tolist() == data.time.values[50:].tolist()
    assert np.array_equal(back.motor_input, data.motor_input[50:])


@pytest.fixture(scope="session")
def whole_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mcap")
    return [foreign_mcap(folder / "a.mcap", compression) for compression in CompressionType]


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_no_damage_to_a_chunk_makes_wrong_numbers(tmp_path_factory, whole_files, draw):
    path = tmp_path_factory.getbasetemp() / "damaged.mcap"
    content = whole_files[draw.draw(st.integers(0, 2))].copy()
    chunks = [(at, length) for at, opcode, length in records_of(content) if opcode == Opcode.CHUNK]
    at, length = draw.draw(st.sampled_from(chunks))
    start = draw.draw(st.integers(at, at + 8 + length))
    for k in range(start, min(start + draw.draw(st.integers(1, 9)), at + 9 + length)):
        content[k] ^= draw.draw(st.integers(1, 255))
    raw, seq = imu(path, content)
    assert len(seq) > 530
    assert not raw.is_complete or len(seq) == 600


def ulog_message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog_parts(n=300):
    """Header and definitions of a log of PX4, and its messages: two topics, text and drop-outs among them."""
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + ulog_message("B", bytes(40))
    head += ulog_message("F", b"att:uint64_t timestamp;float[2] q;char[4] name;uint8_t[4] _padding0;")
    head += ulog_message("F", b"bat:uint64_t timestamp;float v;")
    head += ulog_message("P", b"\x0afloat MC_P" + b"\x00\x00\x80\x3f")
    out = []
    for k in range(n):
        stamp = 1000 + 10_000 * k
        if k == 0:
            out += [ulog_message("A", b"\0" + struct.pack("<H", i) + t) for i, t in enumerate((b"att", b"bat"))]
        out.append(ulog_message("D", struct.pack("<HQff4s", 0, stamp, k, -k, b"abc")))
        if k % 5 == 0:
            out.append(ulog_message("D", struct.pack("<HQf", 1, stamp, 7.0 + k)))
        if k % 100 == 50:
            out += [
                ulog_message("O", struct.pack("<H", 30)),
                ulog_message("L", b"6" + stamp.to_bytes(8, "little") + b"hi"),
            ]
    return head, out


def read_att(path, content):
    path.write_bytes(content)
    raw = read_raw_log(path)
    q = raw["att"].fields["q[0]"]
    assert raw["att"].time == pytest.approx(q / 100)
    assert (raw["att"].fields["q[1]"] == -q).all()
    return raw, q


def test_a_ulog_cut_anywhere_says_so(tmp_path):
    head, messages = ulog_parts()
    path, whole = tmp_path / "a.ulg", head + b"".join(messages)
    raw, q = read_att(path, whole)
    assert raw.is_complete
    assert len(q) == 300
    assert raw["att"].fields["name"][7] == "abc"
    assert raw.info["parameters"] == {"MC_P": 1.0}
    assert [(round(t, 2), d) for t, d in raw.dropouts] == [(0.5, 0.03), (1.5, 0.03), (2.5, 0.03)]
    assert [text for _, _, text in raw.messages] == ["hi"] * 3
    raw, q = read_att(path, whole[:-5])
    assert not raw.is_complete
    assert len(q) == 299
    size = len(messages[-1])
    words = f"it ends inside a message at byte {len(whole) - size}, {size - 5} of {size} bytes of it are there"
    assert raw.describe_damage() == [f"the file is damaged or truncated: {words}; all complete data are read"]
    assert read_att(path, whole[: -size + 2])[0].damage_text.startswith("it ends inside a message's head")
    raw, q = read_att(path, whole + bytes(4000))  # the last message ends in a zero: it may be cut, too
    assert raw.damage_text == f"{4000 + size} bytes from byte {len(whole) - size} on are zero"
    assert len(q) == 299
    raw, q = read_att(path, whole + ulog_message("D", struct.pack("<HQf", 1, 4_000_000, 0.1)) + bytes(4000))
    assert raw.damage_text == f"4000 bytes from byte {len(whole) + 17} on are zero"
    assert not read_att(path, whole + b"garbage")[0].is_complete
    for end, why in (
        (10, "truncated in its header .10 of 16 bytes"),
        (100, "without data .it ends inside a message at byte"),
    ):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match=why):
            read_raw_log(path)


def test_data_appended_to_a_ulog_are_found_behind_what_the_crash_cut(tmp_path):
    head, messages = ulog_parts(100)
    whole = head + b"".join(messages)
    cut = len(whole) - 9
    flags = ulog_message("B", bytes(8) + b"\x01" + bytes(7) + struct.pack("<QQQ", cut, 0, 0))
    more = ulog_message("M", b"\0\x12char[3] hardfault" + b"abc")
    more += b"".join(ulog_message("D", struct.pack("<HQff4s", 0, 1000 + 10_000 * k, k, -k, b"")) for k in (200, 201))
    content = head[:16] + flags + head[16 + len(flags) :] + b"".join(messages)
    raw, q = read_att(tmp_path / "a.ulg", content[:cut] + more)
    assert q[-3:].tolist() == [98, 200, 201]
    assert raw.damage_text == f"logging stopped inside a message at byte {cut}; data were appended after it"
    flags = ulog_message("B", bytes(8) + b"\x02" + bytes(31))
    (tmp_path / "a.ulg").write_bytes(content[:16] + flags + content[16 + len(flags) :])
    with pytest.raises(InputError, match="incompatible flags"):
        read_raw_log(tmp_path / "a.ulg")


def test_damage_to_a_ulog_costs_what_it_touches(tmp_path):
    head, messages = ulog_parts()
    rng = np.random.default_rng(4)
    starts = np.cumsum([len(head), *(len(m) for m in messages)])[:-1]
    for trial in range(120):
        content = bytearray(head + b"".join(messages))
        k = int(rng.integers(5, len(messages) - 5))
        for place in starts[k] + rng.choice(5, size=rng.integers(1, 5), replace=False):
            content[place] ^= int(rng.integers(1, 256))
        raw, q = read_att(tmp_path / "a.ulg", content)
        assert len(q) + len(raw["bat"].time) + len(raw.dropouts) + len(raw.messages) >= 366 - 5, trial
        assert raw.damage_text or "of unknown types" in raw.notes[0], trial
    content = bytearray(head + b"".join(messages))
    content[starts[40] : starts[240]] = rng.bytes(int(starts[240] - starts[40]))
    raw, q = read_att(tmp_path / "a.ulg", content)
    assert len(q) > 110
    assert f"{starts[240] - starts[40]} bytes at byte {starts[40]} are not a complete message" in raw.damage_text
    broken = bytearray(head)  # a format is damaged: its topic is lost, the other stays
    broken[head.index(b"bat:")] = 0xFF
    raw, q = read_att(tmp_path / "a.ulg", bytes(broken) + b"".join(messages))
    assert len(q) == 300
    assert "60 messages belong to topics without a description" in raw.damage_text


def test_our_own_ulog_tells_how_many_rows_are_missing(tmp_path, make_signals):
    path = write_log(make_signals(n=80), tmp_path / "a.ulg")
    content = path.read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogWarning)
        read_log(path)
    row = content.index(b"D\0\0", content.index(b"mufly_dataset"))
    size = 3 + struct.unpack_from("<H", content, row - 2)[0]
    path.write_bytes(content[: row - 2 + 20 * size])  # between two messages
    raw = read_raw_log(path)
    assert not raw.is_complete
    assert raw.damage_text == "20 of 80 rows are in the file"
    with pytest.warns(LogWarning, match="20 of 80 rows are in the file"):
        assert read_log(path).sizes["time"] == 20


def test_a_recording_without_a_whole_row_says_why(tmp_path, make_signals):
    path = write_log(make_signals(n=60), tmp_path / "flight.mcap")
    content = bytearray(path.read_bytes())
    at, length = next((at, length) for at, opcode, length in records_of(content) if opcode == Opcode.CHUNK)
    content[at + length // 2] ^= 1
    path.write_bytes(content)
    for read in (read_recording, read_log):
        with pytest.raises(InputError, match=r"contains no rows that can be read .a chunk of \d+ bytes at byte \d+"):
            read(path)


def test_a_text_whose_number_is_damaged_costs_itself_alone(tmp_path, make_signals):
    data = make_signals(n=80)
    path = write_log(data, tmp_path / "a.ulg")
    content = bytearray(path.read_bytes())
    row = content.index(b"D\0\0", content.index(b"mufly_dataset"))
    size = 3 + struct.unpack_from("<H", content, row - 2)[0]
    content[row - 2 + 31 * size - 2 : row - 2 + 31 * size] = b"\xff\xff"  # text comes last in a row
    path.write_bytes(content)
    with pytest.warns(LogWarning, match="1 text of mission_state is damaged, and empty"):
        back = read_log(path)
    assert back.mission_state.values.tolist()[29:32] == ["hover", "", "hover"]
    assert np.array_equal(back.measured_attitude, data.measured_attitude)


def test_every_binary_format_says_which_bytes_are_missing(samples):
    """Cut, a tail of zeros, a part that is no message: what is whole is read, and where the rest stood is told."""
    folder, contents = samples
    path = folder / "part"

    def read(content):
        path.write_bytes(content)
        raw = read_raw_log(path)
        (table,) = [t for t in raw.values() if t.name not in ("estTDOA", "FMTU")]
        return len(table.time), raw.damage_text, raw.is_complete

    for kind, what in ((".bin", "message"), (".tlog", "packet"), (".usd", "event")):
        whole = contents[kind]
        total, damage, complete = read(whole)
        assert (damage, complete) == ("", True)
        cut = len(whole) - 100
        n, damage, complete = read(whole[:cut])
        assert total - 7 < n < total
        assert re.search(rf"the last \d+ bytes are (zero|not a complete {what})", damage)
        assert not complete
        there, damage, complete = read(whole[:cut] + bytes(100))
        assert there == n
        assert not complete
        n, damage, complete = read(whole[:cut] + b"\x11" * 500 + whole[cut:])
        assert total - 2 <= n <= total
        assert re.search(rf"\d+ bytes at byte \d+ are not a complete {what}", damage)
        assert not complete


def test_a_table_that_is_cut_keeps_its_whole_rows(tmp_path):
    rows = [f"{0.01 * k:.2f},{math.sin(k):.6f}" for k in range(2000)]
    text = ("time (s),roll (rad)\n" + "\n".join(rows) + "\n").encode()
    packed, path = gzip.compress(text), tmp_path / "a.csv.gz"

    def read(content):
        path.write_bytes(content)
        raw = read_raw_log(path)
        values = raw["table"].fields["roll"]
        assert values == pytest.approx(np.sin(np.arange(len(values))), abs=1e-6)
        return len(values), raw.damage_text

    assert read(packed) == (2000, "")
    assert read(gzip.compress(text[:20_000]) + gzip.compress(text[20_000:])) == (2000, "")
    n, damage = read(packed[: len(packed) * 6 // 10])
    assert 1000 < n < 1400
    assert re.fullmatch(r"it ends inside what gzip packed, and \d+ bytes could be unpacked", damage)
    assert read(packed + b"garbage") == (
        2000,
        f"7 of {len(packed) + 7} bytes behind what gzip packed are none of it",
    )
    n, damage = read(text[:20_010] + bytes(9000))
    assert 900 < n < 2000
    assert damage == "the last 9000 bytes are zero"
    with pytest.warns(LogWarning, match="truncated: the last 9000 bytes are zero; all complete data are read"):
        assert read_log(path).attrs["complete"] is False
    flipped = bytearray(packed)
    flipped[-6] ^= 1  # of the checksum
    path.write_bytes(flipped)
    with pytest.raises(InputError, match="is a damaged gzip file"):
        read_raw_log(path)
    path.write_bytes(bytes(3000))
    with pytest.raises(InputError, match="contains only zeros: its content was not written to the disk"):
        read_raw_log(path)
