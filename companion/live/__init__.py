"""The live view: what the service knows, in a browser, on a phone, or in Foxglove and Lichtblick."""
