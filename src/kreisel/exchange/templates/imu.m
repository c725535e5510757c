function [rate, force] = {{ name }}(t, w, a, temperature)
% {{ NAME }}  {{ device }}: calibration by kreisel {{ version }}.
%
%   [rate, force] = {{ name }}(t, w, a, temperature)
%
%   t (n x 1), s, ascending and without gaps, seconds since the start; w (n x 3), rad/s, and a (n x 3), m/s^2: raw
%   readings; temperature (n x 1), degrees Celsius{{ '' if needs_temperature else ', is not used' }}.
%   rate, rad/s, and force, m/s^2: angular rate against inertial space and specific force (upward +9.8 at rest), in
%   these axes: {{ axes }}.
{%- for note in notes %}
%   {{ note }}
{%- endfor %}

{% if needs_temperature -%}
temperature_difference = temperature(:) - ({{ real(temperature_c) }});
{% endif -%}
K_w = {{ K_omega }};
K_a = {{ K_a }};
r = {{ places }}; % row j: position of accelerometer j, m
[slope, curvature] = derivatives(t(:));
x = {{ gyro }};
rate = x * K_w';
alpha = slope(rate);
x = {{ accel }};
S = inv(K_a);
for j = 1:3
    R = repmat(r(j, :), numel(t), 1);
    field = cross(alpha, R, 2) + cross(rate, cross(rate, R, 2), 2);
    x(:, j) = x(:, j) - field * S(j, :)';
end
force = x * K_a';
end

function [slope, curvature] = derivatives(t)
% Derivatives of the cubic closest to the seven samples around each.
n = numel(t);
first = min(max((1:n)' - 3, 1), n - 6);
index = first + (0:6);
ws = zeros(n, 7);
wc = zeros(n, 7);
for i = 1:n
    u = t(index(i, :)) - t(i);
    s = max(u) - min(u);
    W = pinv((u(:) / s) .^ (0:3));
    ws(i, :) = W(2, :) / s;
    wc(i, :) = 2 * W(3, :) / s ^ 2;
end
slope = @(x) weighted(ws, x, index);
curvature = @(x) weighted(wc, x, index);
end

function y = weighted(weights, x, index)
y = zeros(size(x));
for j = 1:size(x, 2)
    column = x(:, j);
    y(:, j) = sum(weights .* column(index), 2);
end
end
