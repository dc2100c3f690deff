"""The ground floor: what people write and exchange, read and written in one way."""
