"""Which objects reflect, from where what they show is drawn, and the reflections' share of the streamed loop."""
