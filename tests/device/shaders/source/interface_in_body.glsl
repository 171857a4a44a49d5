fine
fine too
  uniform int given;
