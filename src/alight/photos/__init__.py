"""Everything that only a card of photos needs: reading, bundle adjustment, work in pieces."""
