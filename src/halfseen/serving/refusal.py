"""Why a request is refused, in one line."""


class Refusal(Exception):
    """A request that cannot be answered; the next one can.

    Parameters
    ----------
    status
        Of HTTP.
    message
        What is wrong, where, the value and the remedy, in one line.
    """

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.message = " ".join(message.split())
