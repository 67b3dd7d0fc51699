"""How good are symbols and events ahead of time, beside what needs no network?"""
