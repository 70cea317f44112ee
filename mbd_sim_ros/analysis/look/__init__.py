"""The first look at recordings of others: which column is which quantity, in which unit and sign."""
