"""Reports for people: pictures, films, replays, live pages, tables, and verification."""
