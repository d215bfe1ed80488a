"""What the missions share: the link, what is heard on it, who guards the flight, the recording, and how it all ends."""
