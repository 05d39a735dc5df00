/* What one_axis.c says of measured inputs, where the device depends on some. */
%INPUTS%
/* A measured input is in entries of the state, which hold it; device_inputs has its number and each entry. */
static double input_of(const device_state *s, unsigned int number) {
    int k = 0;
    while (device_inputs[k][0] != (int)number) k++;
    return s->x[device_inputs[k][1]];
}

static void set_input(device_state *s, unsigned int number, double value) {
    for (int k = 0; device_inputs[k][0] >= 0; k++)
        if (device_inputs[k][0] == (int)number) s->x[device_inputs[k][1]] = value;
}

%GET_INPUT%
        else if (which[i] > OUTPUT && which[i] <= OUTPUT + HYSTMPC_INPUTS)
            values[i] = input_of(s, which[i] - OUTPUT - 1);
%SET_INPUT%
        if (which[i] > OUTPUT && which[i] <= OUTPUT + HYSTMPC_INPUTS) {
            if (!plain_number(values[i])) return tell(d, REFUSED, "set: a measured input is not a finite number");
            set_input(s, which[i] - OUTPUT - 1, values[i]);
            continue;
        }
