"""What makes the numbers and figures in docs/, a module a question: docs/studies.md lists them."""
