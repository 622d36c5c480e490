"""Whether bands of joint draws hold the true response as often as they say."""
