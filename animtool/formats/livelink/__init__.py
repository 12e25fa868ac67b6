"""Live Link Face recordings (CSV): blend shape weights and angles per frame."""
