"""Prints a trajectory as read by the packages mcap and mcap-protobuf-support: one tab-separated line a value."""

import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

with open(sys.argv[1], "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    for record in reader.iter_metadata():
        for key, value in sorted(record.metadata.items()):
            print("metadata", key, value, sep="\t")
    for _, channel, message, decoded in reader.iter_decoded_messages():
        step = message.sequence
        assert message.log_time == round(decoded.time_s * 1e9), (message.log_time, decoded.time_s)
        if channel.topic == "/base":
            print(channel.topic, step, "base", repr(decoded.acceleration_m_s2), sep="\t")
        elif channel.topic == "/response":
            for i, value in enumerate(decoded.acceleration_m_s2):
                print(channel.topic, step, i, repr(value), sep="\t")
            print(channel.topic, step, "surface", repr(decoded.surface_m_s2), sep="\t")
        else:
            for reading in decoded.readings:
                print(channel.topic, step, reading.name, repr(reading.acceleration_m_s2), sep="\t")
