"""Parts of the HTML page, and the templates of the page and of the Markdown tables."""
