"""Charts as SVG inside the page: text is the page's text (language, size, light and dark), and a phone can read it.

A chart is 420 units wide with text of 12, so that on a screen of 390 px it is as large as the small print around it.
Colours are variables of the style sheet.
"""
