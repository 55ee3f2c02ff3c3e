"""Everything that only a set of photos needs: reading, bundle adjustment, saved work, and checks."""
