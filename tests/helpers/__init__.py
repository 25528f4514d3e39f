"""What several tests need: scenes, physics, files of other programs, and ways to provoke each error."""
