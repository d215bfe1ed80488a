"""MAVLink: links, bulk decoding, rates, encoding."""
