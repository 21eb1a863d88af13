// Placeholder of the page.
