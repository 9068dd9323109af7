"""The studio: an arm that runs live in the browser (docs/studio.md).

`session` is the application without a page: the arm (`live`), what it is told to do, and what it shows.
`page` is the page, drawn with viser; nothing else imports it.
"""
