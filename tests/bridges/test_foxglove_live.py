"""Foxglove's websocket, with a plain client: the topics and schemas are those of the recording."""

import asyncio
import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.errors import InputError
from mufly.flight import FlightRecorder, make_flight_row_layout
from mufly.logs import read_mcap
from mufly.mission import Mission
from mufly.vehicle import load_vehicle

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: pip install 'mufly[foxglove]'")
websockets = pytest.importorskip("websockets", reason="websockets is not installed")

from mufly.bridges.foxglove_live import FoxglovePublisher, FoxgloveViewConfig  # noqa: E402


def make_rows(layout, count):
    rows = np.random.default_rng(2).uniform(0.1, 1.0, (count, layout.column_count))
    rows[:, 0] = 0.02 * np.arange(count)
    return rows


def test_a_client_gets_the_topics_schemas_and_messages_of_the_recording(tmp_path):
    layout = make_flight_row_layout(8, sensors=True)
    rows = make_rows(layout, 20)
    with FlightRecorder(tmp_path / "flight.mcap", layout=layout, start_time_ns=10**18) as recorder:
        recorder.append_rows(rows, ["hover"] * 20)
        recorder.add_event(0.1, "hover", "it hovers")
        event = recorder._events[0]
    publisher = FoxglovePublisher(recorder, "127.0.0.1", 0)

    async def watch():
        topics, messages = {}, {}
        async with websockets.connect(
            f"ws://127.0.0.1:{publisher.port}", subprotocols=["foxglove.sdk.v1"], max_size=None
        ) as client:
            while len(messages) < 14 or len(messages["/truth"]) < 20:
                message = await asyncio.wait_for(client.recv(), 10)
                if isinstance(message, str):
                    content = json.loads(message)
                    if content["op"] == "advertise":
                        topics |= {c["id"]: c for c in content["channels"]}
                        wanted = [{"id": k, "channelId": k} for k in topics]
                        await client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                        await asyncio.sleep(0.3)
                        publisher.publish_rows_and_events(rows, ["hover"] * 20, [event])
                elif message[0] == 1:
                    number, time_ns = struct.unpack("<IQ", message[1:13])
                    messages.setdefault(topics[number]["topic"], []).append((time_ns, message[13:]))
        return {c["topic"]: c for c in topics.values()}, messages

    topics, messages = asyncio.run(watch())
    publisher.publish_rows_and_events(rows, ["hover"] * 20, [])  # the client has gone
    publisher.close()
    recorded = read_mcap(tmp_path / "flight.mcap").messages_by_topic
    assert set(topics) == set(recorded) == set(messages)
    for topic in set(recorded) - {"/scene", "/track"}:
        assert messages[topic] == recorded[topic], topic
    assert topics["/tf"]["schemaName"] == "foxglove.FrameTransforms"
    assert topics["/truth"]["schemaName"] == "mufly.truth"
    assert json.loads(topics["/truth"]["schema"])["properties"]["position"]["required"] == ["N", "E", "D"]


def test_the_plant_of_another_autopilot_is_shown():
    with AutopilotPlant(load_vehicle("mufly-1.1"), Mission(name="hall"), rate_Hz=250.0, autopilot="PX4") as plant:
        view = FoxgloveViewConfig(port=0).open_view(plant)

        async def watch():
            address = f"ws://127.0.0.1:{view._publisher.port}"
            async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as client:
                topics = {}
                while "/truth" not in topics.values():
                    message = await asyncio.wait_for(client.recv(), 10)
                    if isinstance(message, str) and json.loads(message)["op"] == "advertise":
                        topics |= {c["id"]: c["topic"] for c in json.loads(message)["channels"]}
                wanted = [{"id": k, "channelId": k} for k, topic in topics.items() if topic == "/truth"]
                await client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                await asyncio.sleep(0.3)
                for _ in range(50):
                    plant.advance_period(np.array([0.9, 0.9, 0.0, 0.0]), True)
                while isinstance(message := await asyncio.wait_for(client.recv(), 10), str):
                    pass
                return json.loads(message[13:])

        told = asyncio.run(watch())
        view.close()
    assert told["position"]["D"] == pytest.approx(plant.truth.position[2], abs=0.01)


def test_a_port_in_use_is_named():
    recorder = FlightRecorder(None)
    first = FoxglovePublisher(recorder, "127.0.0.1", 0)
    flight = SimpleNamespace(recorder=recorder, log_event=lambda text: None)
    with pytest.raises(InputError, match="cannot be opened"):
        FoxgloveViewConfig(port=first.port).open_view(flight)
    first.close()
