"""Weights of the evidence, from 56 simulated tuning flights: `bench_terrain.py fit`."""

# term: usual value, and spread
TERMS: dict[str, tuple[float, float]] = {
    "rough 0.3 m": (-2.952, 1.194),
    "rough 1 m": (-1.999, 1.196),
    "above": (-0.01872, 0.1426),
    "standing": (0.2285, 0.9617),
    "residual": (-2.307, 0.7615),
    "residual against the frame": (0.1558, 0.6726),
    "residual 2 m": (-2.244, 0.6541),
    "sigma": (0.02272, 1.355),
    "restless 2 m": (0.1361, 0.2606),
    "unsure": (0.3265, 0.3949),
    "refused 2 m": (0.3567, 0.337),
    "texture": (-2.406, 0.8189),
    "texture against the frame": (0.2194, 0.7982),
    "plants": (-1.911, 2.274),
    "light 0 most": (0.01899, 0.04129),
    "light 0 least": (-0.01963, 0.04219),
    "light 0 near": (-3.538, 0.7836),
    "light 0 near against the frame": (0.1834, 0.7432),
    "light 0 wide": (-3.434, 0.6347),
    "light 0 wide against the frame": (0.1115, 0.5293),
    "light 1": (-0.00105, 0.05509),
    "light 1 near": (-3.305, 0.8339),
    "light 1 near against the frame": (0.1938, 0.7993),
    "light 1 wide": (-3.18, 0.6637),
    "light 1 wide against the frame": (0.1143, 0.5648),
    "light 2": (-0.003438, 0.06779),
    "light 2 near": (-3.211, 0.8643),
    "light 2 near against the frame": (0.2088, 0.8374),
    "light 2 wide": (-3.062, 0.6844),
    "light 2 wide against the frame": (0.1248, 0.5955),
    "light 3": (-0.007921, 0.07983),
    "light 3 near": (-3.13, 0.8863),
    "light 3 near against the frame": (0.1973, 0.8526),
    "light 3 wide": (-2.962, 0.7079),
    "light 3 wide against the frame": (0.1315, 0.617),
    "light local": (-0.01284, 0.1553),
    "light broad": (-0.02619, 0.1689),
    "darkest near": (0.3036, 0.2847),
    "darkest near against the frame": (0.09718, 0.2784),
    "brightest near": (0.2327, 0.2055),
    "brightest near against the frame": (0.05181, 0.1779),
    "red 0 most": (0.003843, 0.009032),
    "red 0 least": (-0.003889, 0.009131),
    "red 0 near": (-4.801, 0.5518),
    "red 0 near against the frame": (0.1563, 0.4831),
    "red 0 wide": (-4.731, 0.5076),
    "red 0 wide against the frame": (0.09785, 0.3969),
    "red 1": (2.479e-05, 0.01211),
    "red 2": (6.209e-05, 0.01628),
    "red 2 near": (-4.571, 0.7561),
    "red 2 near against the frame": (0.2025, 0.6963),
    "red 2 wide": (-4.44, 0.6798),
    "red 2 wide against the frame": (0.1239, 0.5507),
    "red 3": (2.388e-06, 0.02115),
    "red local": (-0.0001031, 0.03841),
    "red broad": (-0.001173, 0.04668),
    "blue 0 most": (0.006967, 0.01733),
    "blue 0 least": (-0.006908, 0.01735),
    "blue 0 near": (-4.432, 0.7363),
    "blue 0 near against the frame": (0.2169, 0.6748),
    "blue 0 wide": (-4.33, 0.6427),
    "blue 0 wide against the frame": (0.1334, 0.5291),
    "blue 1": (0.0002564, 0.02285),
    "blue 2": (0.000681, 0.02855),
    "blue 2 near": (-4.162, 0.9136),
    "blue 2 near against the frame": (0.2759, 0.8724),
    "blue 2 wide": (-4.001, 0.7769),
    "blue 2 wide against the frame": (0.1708, 0.6707),
    "blue 3": (0.0005271, 0.0343),
    "blue local": (0.000738, 0.06717),
    "blue broad": (-0.003148, 0.07475),
    "height 0": (0.01655, 0.9225),
    "height 1": (0.03424, 1.041),
    "height 2": (0.09129, 1.363),
    "height 3": (0.2102, 1.634),
    "height local": (0.206, 1.97),
    "height broad": (0.703, 2.528),
    "highest near": (1.58, 1.803),
    "highest near against the frame": (0.4495, 1.771),
    "lowest near": (1.332, 1.776),
    "lowest near against the frame": (0.01228, 1.718),
    "steep": (-1.679, 1.191),
    "residual spot": (0.008462, 0.08498),
    "ambiguous": (0.05171, 0.1923),
    "restless": (0.1362, 0.3182),
    "step": (0.09903, 0.2611),
    "saturated": (0.04208, 0.1804),
    "textureless": (0.05443, 0.1861),
}

# of each layer: inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats
LAYERS: tuple[tuple[int, int, str], ...] = (
    (
        88,
        48,
        "5GHi30VxZo->f1rp{)uU#IBj52Cg}#7a>ur3#dz}PLaVaDyok!S*w94w5DCD2&}BI>zQLN&L#x16ENwh&#IrTi>E-bv7j<6(J_&%T&?h"
        "=C@mEtPpc`b+bL`;VkKQ8UZ8R>04W)jawe@U7%iVMgsT{@W+`Nsh@$4M;IDD4K&PFso+V(iGbUcI^eq84XrqcRyDrwXQnaNqs;xG&h$q"
        "!01v9HG+$=__5vwXLb}vG$C9-!WIIUAGo**o!mo7sri!C^-7alY%5v5J00<q>RfTrv(sw&N_*{F@J%B-cY*Dw^X#IvxRs3wRkTCG4YqA"
        "kp^&Z-QkQmnG8Z=v`q=BZgL!X_4|s<D)-KP?b0Ehb_t*sO6e@TX)gpsi6X=P(W@u&%nR#i2|x6{agK^`<H*iLlhIMV+cIwxt`dS1=u@X"
        "`^l^)}~z}Wi5N6n<_1-tFa|2ekk!OZzcUQHYvlT|1WSZax1MbP%DwDk*%MqMlE73G%1s+*`)iedah|QcrBZ#ORR#kN~Mh}Q5Z%pKQn12"
        "C$ynA_AL=J?y<nIRWkal^{`+q0x{t-Zm(-Ds<FN@ezZU<o~Row?lL$qyR)DzL$m0vu9-G8!m*Y#EH1?`601%v1u>4W1FSx^5Hmim6REl"
        "_gfwt4C@A4Hf3eJ>2d?h8h#NsJ@G^<0b}P><(=doIbuUyb@T{3J$+GgQv^aFIPOqf2PBM6}6|_+--l<=!OEBUyF)n*5HlUKS4j6;4Q?B"
        "zNC$8f)z^Ab@eWvoK4W_}bp)^df`J^<my0JtwPMg9rhp;2DB&sg37Od$od$8R$z^}3;!?74NrM2-Xge1Z#!!+D2Te6!dkg(D#eW{lwB("
        "?r5bS(BU#Hlqg>ZQvt7AB~yJFT*-D5~)%4yrUMMX%v0Jh1_)L>IT5<s}#^4z2&DZYig$A+1z1wl3A3yDpou-K%9TNhbCkU8Mmf{xLu-Q"
        "mG0m5~l{DQ!vabyeUqQ$P`MQ(k%@x*rtgj0k9M{*|0#aG%5=%Z7Lro`7Z^n7%PB~penjAA}NNe+OKLM5U|Ct!l*r_0<Y06DkpWS(x#`L"
        "DzVQc4x|AxsV&K|J*=TE@S!lULoF?<hA{}OXeyjEsH@7UYOO;d`X<dMtDny=K&@+~#iv@Vyezt}<SQbb{3`jUL?Pv<5US6l2qgZXv=-+"
        "l@*{aCiLd~)l$}W=&?OVFh@M!fQmPj#`4+z;Nh$Rh&?p5fyfF48uqhBJP%)ygR-#s|TBSNKai@+kvaFde(yFVir7iKTfuX3iZ=)k2(<m"
        "RR)~pe+<eC_#h%{O=nW{c81}QhN8?PTO|FPAubFE}2qA#s3x~k`?53r0e7$7LFJ}~1j!mO1n3oh>~aUc#XMk7TjR4hE9DyW?+Vkkc%5w"
        "dxt6twoRsj3F7B`JZKx2Gi~xTOWJ0WSL&88BzAsxKoVl%|KQVXN08J~8vHh$%TLY^Lv|q@<;!IW)zh)i5e30Iuz#k&{=jEuQnRv?!jbD"
        "5`U!0IL-(;;y70Hmp}DkTIq(os(&!$fk@ca3|~{@g?)B=dVnb3#~^gye`n7E36<bC$SAG${oNEU>!>&h^Oo<WwDv9#WG5(W3jfV6{Byk"
        "ohrVuNh<O%HLLd^n<>jNp|4D@xhqC1CaZC@hOr^403~gpiZCfJC9iNUl&r5cm$4%#vLEE9y09s#<SU@2Q7&UJI4@x+%PxB;p&~UdU8BF"
        "RHY_$S3@&Fd5H;L0Or@MGP$fSoUoIY)#jf`%*{G4JY^sD8QK#ppGpz+0btFimA}nRClc<EIBP8^v<1bX9PAu`Ot1M=!=b>CBOsZNVRx5"
        "NWS)(>1?WYB-(yga0aHt_F+9nAu79jg6^Oo4GRw4tMF{<z=x+)2%GM^8i0xB$-yR6Zw+bc#WlAt&&K`LJ^a+I$ol%*T1@SP2%>mQsex~"
        "id~uq7iQDI<xjXeE!TfhgFg3?LLO=BSP(@utS4*Qjf(@}<2WT(8?U{j)172r*_d7qZGIK`~CWqO52w^D(6@lC!BS7qvYtp08l8>#<@Y8"
        "Z))993vd9BQ!869W1=CcBc@nIx#mYoTEG{2(1UO7cIB3)1^@`YpU)q>oQg}DkRk~<ElTiSg;4R(=WpqqAWQrudk%Dkgk9)rXvEbi!@6t"
        "hAf|`+N`d!KdbkvHZoK(D<vJT#Imxft1f>hUM7<jMy^aS#jVRMDXzjUoGcHmGO$e_6e*)JYOwAt6fGIEI2~LwL$z71kTS(IQJ?Xw|0un"
        "$T&_PLx-X0{MX_b3!nCI~M6j=@x2=(>Dl!`_Of8?ULo`Dwe=!ZPgR@$%B`R{WW2f0F4<?SKaI2!SH>i54bFcL)FEju(fhU|RJt-Cz%e6"
        "(c6DsnojT*=@iKP#;!mYWX03^??oiXGyeK5t8z^UA@O)j=B-ZCXHpsgLT@SFm%hothUZnA};BQ;ARs-(^>lcD^akFRJetPaC2wHJ3VU9"
        "WpCtS$ep7b9LIjI92tULPkZ*Q&@TsH2;nB&xrh6fa_?izYM_-z32$Z!Tx5bf>GP#ipb#+8n<qy&N{6E2WvCuObJDlpqYKGOJ6d=cGC+3"
        "o5>*TC66npd!ww-YO2Od>F^41}Wn)s2mxn@i9NBbStASAtHURFsSG;?Jct~lC%=9e6zB!OQ}Ys#j4OHr>2i6HZeyd#xd3<10hSOORRvd"
        "mnpcc<){^~vne^MLNUm&$D1CojSyfk1~fz`A)(hFc(bOXGOB5*peU0P(xe)xaHr0vc&}+KFsP~|@-*@;p0Fq|Yp#E;vMi0Pr7!xaS1bO"
        "eZ?0D^nJyNngCvJ5kAR;ooUgE?;3`C?%Ozv5-?054#U~Q2|E!&`d#62}5HglA<*_xeD=@VuoGeH$(y=|NA+N6}G%Q>!3A4hhFS6h&KdU"
        "jV$g9h&v?if0@-g|R6E8%lq$<gx%&!2gX0H6Q<0u!d#VyDy#4)X^i7=C_Ypc;9Bs2Y}zAbw%`mF)6HL^0Yb1aLphAH_l;IR3v;x8X6mM"
        "N33pDkN0I;>T+cBKd%uBc=ryfB6=*D$E7tgs#-!>P6@fU^E5q9MjE>n%*NGcCugm#Mrgbg()!Un*iP2Cbg0q$UTl^DD!pW}GCVB`;PYk"
        "+B*lMJJxDGp<LR3y|m<p(If(q^ORrKr3&VFDPEB?~}8jNh(mQima8Qov$@4?5s#Cz${%QN-Re!xv5ww=`4<|U#w^`I-HuLO`xu>87VoY"
        "CM_@_XE3;;tSo;eswdSkt*Azj>m|M|urCI%MYOZBM6Haj_Nip1NUlJnqprO%ye>JcA*qZhgRJwN*CYU{)umFZ!Ya0|%qLc<EG-W#)TsW"
        "R{+(1Tj4GY2VK8|qldU|hJTGLe!z3H2$f=8+KPjp#uA$W_NU2aVoH6(?C9btAQm6WzJt5!-9Wk-2*en?*xTkzD2reWlT&=1rX{Caw*_<"
        "w{hpj9r8>)Jz>8zNnj~;+6pRWqA&8%XtDKfDz%c_Sh5GZ^tTP>(56s%q;#IeUK;jJL6U9-Ejw6KINy`l6eOsuICaIX3%#w<sztSeZg8Y"
        "#4-T`e`R>Zcj7(l3dy6EE|kLNbD^n5oF5`mbiMt~1iAMyL8P=&QG{Tcz5nnJ6={qcBe-CoU>2OtVy+E~qs!z%^|$bEw)aE2O*{F)qk0E"
        "vfXEu_i4sGN>vkSuU3;1+u&^dnaO_A*ebePaz5^^ROHpsIFP8Kc|K$;j#U%0<2lE(x!GT-6X#x>n&g?V<Tg&0xKpgNvN7E>af2n&#ba4"
        ")v64z2{5jycQEj&y{`!>G_BvO^QnX>y(}*+0xM~+Ij9ILJf6!giK%|1!<-B)n=Re2Yb^~dASr^bMkLd%y)qaqt}bIO)vNg(rYu1q=%?B"
        "w6_{VJNV49VaI_V&XR0%+xTzGT6&&{{2OFWRIWC<faWJ*6kt<Cpxgj7dD<|!;wkRN-Yb<gkuP9fos-6`nza(^|GBc4X)2;xod#>`Sc`9"
        "Wr!KfWDaIk%^I4y}QQm!1Gi!gOAF)@`fBP$Xx$Etszkfi7;$edj+XsBT??XF}kU?6)fEUf)2m#+k<8?FvA`mH^o)U91E9jkb%0IIktB("
        "jUF@}*NJyfY@Q6flo02QKljqcDRaL$oxczp=-zV6thhvaklWPq5jo_a*48i74i;yr+99hcP8D6D7j1VlNvhU?nv#1+o0IgfMd_yfWD=*"
        "fRsG6|hPr1)MspRxrvahpbk!5U_6|<t{xdW2cCw(y^T&UMTM_ajx*O`m3lV#VJlK7A=!22PpY2ZJ;bN<*Z{YEwB4D!K=_N>m)8P4x_6v"
        "MXd=Q+#@M4pDu{6|FFC=!K?Zsv93E62DBTok)rdez^c_1Eg)GhZJ;}xMJzz4x+u;s#xEzNoUkw{u&9qDQLK0|;V@mOdMh6#lP4yoKqwO"
        "`jIN_9rK(IXoGyYO{jEDMH6=Q+R4lwHQKUOBjF%IyHKq-*Wurr_CaV!F`Khlk`LNlZS*4YZs4&#65-_MV&no#cpRCv_YO75x05jPtb~N"
        "R$KQaug<g5#-+p$8k!>`~o<+6C7m8DX)t+iV-3NZzxqp+qd#;~I>Q!^qd*D-@F__61-)hH~mq$qze7BC(z-!QwWa;(g>AF<3UHYs>ADX"
        "^j}QKbZ=Vz3pdV=zFCIVANcbgs!Sn69xZSuw`6uC0C|Trrrfm?)&IUoWk&Go7NJSu72yk1<NI%dQ46Bq;Z<8lWRFt|)}D>#KXIDlNOJv"
        "M0!?7cq0IUa46qb+LS|i!^>K@Umbr6dcpBt0ZBm^dp@b3MGTGp0O?};;)UV-LE63TdvowXDgr_T&ch$3ood!cr6DoHLXK4VX-i#$Qw_t"
        "6s-~}{xp3oX(7lk`6LjnMkR_cqN}4Z9V=`v#46^pb1j50$E4jZ$t@Ev8nxXrrm{RI87$tbnHp}c-YzPy_%9VSNU<oQOstr*rmCbW<rs0"
        "ZYc5?aq%xnP3o%$R<*3N7lPeG@B`miqZz$3%H7=hn4x-~B4zBaC`XRfktE@FBGbi9BXsIl(kR`CNE3qH3+pWJZ!63M=@vH?VBe3!^aHK"
        "P+Bc}JQ+pWi|EU2tAGBO(}T(7Gu5wIt)3@m}GGAg1fG@ON>K%s1_J193U4X#b7kEQ=7NTn&MJf|?NUalP-E+^-$=$~34;v{XQ5vqu#nk"
        "K8O3Z@;K{|`Z{Gp`9LSS?i|2c)g8mJ#)*K`cWl#HGoVj-<t<0U$yz(5>sN1SS!s1~V%xG?^8vr~rAL^q90J?w>0s(y7#?QLA$wl_sO4i"
        "In`Nd$8D~1u3r*tRG=0_NC1!Ml1y^8Y;plv#7_W?x%b!J1cG*>8Nv(V<-KhQ!5~#r!#)D=9#`RS1eqwJEoki?I8!SeW4bsSF0kWqcZfY"
        "ai*B4kFB1vzn{pf^r#^)IhRSOpsYTvi?AoLhpcleCzpUKcCcBf%`$2<{Usi-Sf#kN(IXuxUbXlk?v(|l88rr-j4oKQZLDe}eVFvA&8?v"
        "k!Z7Wy{i=YdS+l~f$RQB1)2|J!;i)9EYB1=m$TZ&{(WLFK=`44#JD}^MPo1SG8z3$(k1g@8;V$|m&#C4!uQK|fmnyNSoF9jz7BnTX%rR"
        "XwTrnrFjw{F~HZEkZO|K6kzAF#4U=>NO6RcI7n5>noRjqCm7Oh++aG-!F8Z0NUBD3qRh^J>RaUn7*6|<2VG&FlLwIGuzRw^K^bu1AqZn"
        "dW}{-s2!=rdv}rZV7|#wlHz9G^;{aIDHO#HMep8lsl7?61VEjxcSbWU2zINv0>TZz!FvZ7vNZ*Baoklrn~{nJcd`%dG33WvDeXmMj~tE"
        "v1h!t{)sV3NIWd_Aq%cG%KbmcdXf{o-O~O!k&XH(K3mofFSlIf294J;HrctVlNRI-yskz0<b5nB{1V83Lt(WY^yS&o1I4_fGBXGWhs!W"
        "$D%kG7bz1O!>C`WGpF;Uiz}S4q^jPfu&t#f8Y*%b2%N1Lpezxus-~wX053eP$sr7)Cm}g3w<bWQ)-O4#nW`u(Bd}+!=qG)tKr3l0u^Zt"
        "k^C-h9rltfbFRm)C!K`_%Ga>dLY$P)#`Wq}RYcAH2btc-KyqyXu{EImuD=Z+O*s!!MC@A`^s4EAnoh(VLVz2owZ!wZEpD^(%@TLo-pp="
        "EQG9{R*&#q1_zpG!V!6KlgO0V9h!mQP;(<%`wDzFNy88Fi>n<`+cw4pS$4JW*<$+2suNGSgy+bUZzi7r4TucQ<#+^zK@H>D6UHZ2e-;-"
        ">;A`mw$*wXSxTPO~Mla;=53I4&Hq<1|yFOfc~(<R?y@%N?<>c&1z|PBD|Sp%^c#nWYOX;3i@?yQ#FVpDGNh1(BLC_%au*L#(}*95GR{-"
        "7#vX+L#2VKCP84Zm2o4#V^RJPa_?%%P>&1Xq}*~wyZ=n7P670m8Kf4gRl-M#}q=Y)hXqwVzIL*^DkvExh>t4rz~8w>Moq5y{(TWQ!mQ1"
        "YABE|YM#p|`6$ILU9XI(ouxrB3b3i6z^IfmAun_>87yBQJT0fGx1=|$uAWe^mo2ldu`L5D@Gy=b<S|LD>ndlg0-uYeU9rHgYN9_cGb=?"
        "dku0N^KrPFvVlE*ukf<OtmZV`XRV?x>ld@Z{S*1&`)2v@BzaZbL#ji0Y<cNqVGO>ahwWPrr^{m*e0VUukjV*){)+zg+*&qureW(qw8mi"
        "DSJu#pvSS&^^CalsR)hlu^?j(UMcC7*^NiX^?DxUwTDJk!&0x4OnD5!6ot0)PsPArNk7O-0+#3@^?PqJvLa;w8JQ7jphbT0g+Jtm_WnJ"
        "8*55iSU^yD*!vU#{ONww{$SB`}a0CaZ|07cCYn3@7L+(5~zyR4t1#h^~bt%B?n_Hnj4vg{_>TiYK})yf1UI8?q)bZZZ2S&8n{?xvsM>C"
        "8-3lx+**)RjeSeFRAeymobdAjwute7P6K#T&_PaU@+b@y{iE&04*~sktNC{bhzlM8?87k=&VvK=&X(=wz3YfK_qdkny!PRWiD(MIVuq="
        "i6=}hbu31!JuB9%ucvIQD5^g$v7iehF0JLPWvzLicBoh=zNro-a0{#;h^hdaHm?w{x}aOFG$`L89;n<cydF}l=`3`xi=<$t&8AN=X0gK"
        "+;xr5?{U@5P$gI?=psN9{S}ry)C$Frjlq@nU1vFHv0U#cXNS+QZzA9L%imFAb(kid1pQ-<$v@hx_x20n+LZKlgt|)7z-6`CyvZ0wPX|u"
        "31G9eHybgW9VOfbQ*?64TBel)$U2d}Oy?5Hj-7q3mNEvB3+m8UthHMChTl_@bP^0!2(AF|FYbRh#Xf~W*Cmn`6+H?#_@TpzQtO(%;jU9"
        "Va#YO>BSa4lG-a<E#k8!AetTrB{z6{eCPcoHKhbF|AS-I=H`xhD;&VxL*BBryN6WHOnwv?)|7@vFn5jjg6BO)0A^S1pC0H89d3p{Na%4"
        "51OOK&2@#NHLKxqcE?i`m%<yJfZg~mb67OM=5<TQ>fXrE-`tuJg&E>_b^Sem#~N*bFuO;3^6*cF0j`qhagk1p11j^3LV=q2DmXECbi5k"
        "bS;gmm7uSiM>KmZq^vNlpB$&NU#<u(JFt&3-z7ONpQ(zh#HO0Ey(>U4yeQ(cL8^+Y945q><FEUtW2$W}{VgrB>oMY|05OFt95aEmg|)A"
        "&k+K3XgS7%Mbgf4;@ife`S}|j=^e`>39VeZv<*@uLlO78&J}@9Ape)U+Q>FwUB&A_3Jf(1)Ahb~~qNu~Ex~!Zeo2gBv-!M)t&o8tsGBD"
        "dHI4PMd>8)=m6`uVpMX5!r{-DMv8Y@OGkR|>iRU}iYp(pk)WS#D(&#<bd$(+I^MXE6vp(=4J8!!1UjGO?deWn+!t*}8W;FZlTzc3o2wk"
        "o|Rf3KRO2&S&A*D$}LJf{~dK`5Lo@h)2-6eY`{AtpB<^QqJ%tE<8!RWS4_LnZvLxvPn)RIqU`Fe~UTT`VT7CaJfek)Zaj(Xw(fJtw~-`"
        "z%(m!7p^N#j^A=FEWU)LNK$iRH%`u*e%wyG$<Ucda_WWf3>)-4zS@P$Fw<{w=H9@hb_l6R<Io_gDGH}DkX-lBB+73FD=NfVXu^_=&;@_"
        "sGByaEi;HI>KkaR%O1F~%NBAmx*JR+^0UY*)UC6tfhm3_w5sr}iJ5n*5T;hN05hkpKCf*i0i?YzW-c(EJgloN4lI|kBC0{M7cH_Xe6RI"
        "1yDEMl9xYd_vayk`*f5;0nI)+r$DwAdH!w%2t0-Bo_pIwD>@6C!thHpbRWQydi!@2D6|%dagRniW!Ll_Z8Lq-4zq8OS%B{O74Y0ke<1p"
        "eRZY(>hdobrNyDK=S#xSL)m@WLR^(fw~t0!8dc&s<5DX@^PnjToRY$yLO9<Qx0m#{81nK3~slQFlYmo#3f6EM0bjI0`}8?ieiKdoXavZ"
        "YfnBd7{6nk%^|LM@K1kffckCMY7R9I7>_?K8b3WHIuwy(ptBRIRZtPb|+Zj<8W9YAd%ZW-uour!LT_f-fhhx1+JGJtPj5>@@YFYNyUCh"
        "o>7SL9O<vX0?(q6q&FiuaZ41;jM=<R;U!IpPXT;rYm=vmZ%e{oGgu{F`b{U2(lF`^Rc=t^&0sxyDOF;->jLcurJe?|0m-sm8GjCHzXvV"
        ";;C6KH#H3@53jf{N2tcI`>@ThTCm%t<D)Pp0x}aUXDWU*9Glm#%P9w^_%Hymu&aNr{3k81Z7ij%#;iUqxF}pSAv7Q^zAsa&ax--^vN3k"
        "8vo2GyKc@;X2edM>W2h!D$}EZ~JF+P-NuVCG+b`~}!?iLnaW&ek4I#;}Y%P&5^sIumO0*;@moz4`p0Tg4&Kn*i0W+Gdm9}3nJ)bD3BBl"
        "5$GbFYqVxSA5vzc-u`lz0qmLYa5uq_{(uA^L?R-b02M<b>qTB;79XB&r=TB5kBm?y%WIiz+QekGZvgrUD2u&Tlz>6%=s2%|BkVI|C_GO"
        "QaVh$HP3L8fvdbEN{L^CUW=9jD6=QL9HO{3&&<uAC&TZLD6L$|j2rKPr!>5E$vLv?<jhwIdglY$dxR{;3KiyDXxm$Ent=ttmh!EiL#Pl"
        "&RCEKp^xe&nE*QdzjcDsGgZD=B5)OFeYIk0j*;w{i<sq7%0T35+@ZX)v4kO4K1K8$}Cr_*dXmBR-m!0#w~*_KCBC@x~I4&t)-%>wII}}"
        "jhPrRtfxYXt{~him8aIA+KwuyX(bgKa37c)aU)R~BduSkSR!hztuy+e94wkG9;->9yCEm337AVH^Q<B;d@0u}jiART_MK3$O(~nGrJ`p"
        "hB`9m7NuKJmZ7Lxwo+YX<dn>M|U?oYR1gDlPsV9i3#jJ-YqAau{1ReG%q^wyecPV)qTQ8BSR;_X+{G|6PJgJi{bf^>_2&{Lnrz$rtY$n"
        "MsK%z>dMXkLcbgXhBlPV=7NTyh_J}BC)6De&kd7QVVl&(6gPbpL^nWZDCaW43)wJn}3NU1I-izXT)&n@JwvoZE44ya`^)vl*4<fsv`x~"
        "=E3C#SY42rvaI2rTHbxHFO`mZqwwA}D1wo2~$#NGPkQ{;;Vfn<9-ZvnQD`3NBTy6QM9Lx+L+VNS3Ik10h){sT{zpqo{c(1hIdk0<fwuw"
        "x@usqOEkGfUNj0<1cI}vMDAl4lJ25q^S-p5UvHV*{!58O|HeNkFH57fU5+sB(HWQQzQ{DJh6kMOsh7mlbYHsL8i2@y(yt5Dl8YBW-w+k"
        "@hC*Cn=t*ahcCIaJT!?c!KuZj2{B@vBedSHuCYt0=&O0NGAuYQ53MC8JE@|uAuc(o8!XqV1t_<uNT2H@w4xp{O*Ejfsih4na50RbS*A}"
        "hRw_y`zpR!KD6XKik0o`m`6}2ef3CkU<D6)w5~2nwHn4{)|E8v`6*70NkEK~NzpHSd#~^Z~{HjqdZK(CIGp+G0Yp^FQS}K65a-<%oT&-"
        "Lrxh^58QY%8FtER`KBCY?ZU9R~f3aaNWJEoQ_JT9A-l`degN-D#r1+H(SeJ)g@ESPStxU_CCwJo}{l`UK)sIDBRDJZcfbE{dXyeZbLV<"
        "3ho=cRt9aE^nh`7u?W6|2ssEiK(F!>EiXG$fj$-<>U}GO3BLH>@itFSJ`S?5)hPq%BRa$u9&dfU@GN1u>m7J2SZ<XR=JO<*dW5Q8THow"
        "<Zjz=%ZOKp|066G$;MERI-Yok}VRj%d)>BYAnj83$ZA&KQ06pG%_qCS*0bi1*-lodL11mrZDv?EwB9;)}#lj4lF36WUkYx&8V`h#-;Bl"
        "b+5TA6RO>;x31r?`WZH-L#Y?2QYdGrRVqHSj;-#iDJ@m3P_&sS7c0puRH+xI7qix&A2MhsU!)A6*DIzgC#`C(m?_jO)-VApv?@=fu&*;"
        "2F|BVbJ|G{g`6?D69ViGVs;q`1ajhAlsH>0}#HM|({I9;44k=HtEGdtr4zN8V7pM555iVh%lP(3GVWXLro-0nF7_ls^Bc|+?+A4{nTq>"
        "xkohETHt*kUEzNpkPr!FWeN-DIp5heK?e<9_qB(2*m=&{<Eo~kl0w<B4t?y4&?q_0FN!>SmrEwY;)E~fLKQ5ZI{5veXH8?Fv4ATF_`ES"
        "eD|(5%@c&MeZXkE^XOEh}xPiKVKhTd8#{xvg}pb*{;yF0CN3aIx|s+b)QzP%$hoXRLy&BdbF%f~*j*V5iS0E35*oGq2&OiY!_#(<#iRv"
        "ZP8OOQ-Co1~5XYajW~7`J}3$TCh~EP%MI`RxtIK!!aAJ5U?*Y%`s3e5UO~t1TQ75NGRPf4ln;NVXzsm<0Oe9^Q}RzRjv&%kg1Im86^0o"
        "1hH-`wIi*n4X)Rtf2ts_H>*`B)2rJuf~SHdy{7#klOm6;&L$l!|E*)GYA9i{5|}+Px~qOJ_OZsS2Qr+o1}KUyn<Wyi0Ws95KrDE#gR3k"
        "kk*o5sX{g$;=qoQQ$EM+-Z!rTcLowo|U8V=GU?syOtt!?l7%JDRKe2_Vm^z`cVlmG#9i-VeDKefmv#5e1g0z*iQ8v)DEVx}g_c&)OezG"
        "mMnYcZ+tu{?3#xBOVa;ye6bT;HXNj`3<K{o}oA+HEBAHAM81F@?!lQ@jDvbI<?s<=2TSTv(H",
    ),
    (
        48,
        8,
        "ayOkZ=Q7>1d$w1&rZfU6r#E0J?<@QzWw3}huDNQpy0Ol;_p;SDo}vf1;Wv*rd9-vhFfchVG`2xG0Jh<yA+g<|rKdSL{;=P)Ik4k0oUNj"
        "<$}e&*oH(X7A-J-)VYq;?HL(S*iLK)_$2Y4s1h5b&EGxdZy)k3Bu``r8%Qa@RVkrT%3ZpwUAhr)ObT_xSKdy_k3#`nsYcn4>1h_P?OR%"
        "D>v@TvV2RR9_EVj0^CpR&qbg+6b-L2d-XSCL-O(*XyMmgKGb+{llemQiw7%y5VjjrZ5SF`lA9Xl_$hBHDVue8ZF-no#oG%jK|%s9HYp0"
        "&L)F1ORNZa3pLhP2VJYq7<+W;6&cQ#hHjXEalw0WQ%ub-J9k5tmH1Xs~9rRkn~aRXJHTxHL7j<G1xNJTk1azc|ORaW}TNBQE`$)u$pZA"
        "Ggmn5IF0woSV?8y|1RX{WJj<(YW%mGd0*PRH7g^w<{~EpS1Hh4LJ+61G1&GB^r&f^09ij*th(z;I9@qPB>{eTeO(7O0y_A?5a?#53~<B"
        "!#U%zeKB&fWVL=V8?_)Q1UT!m60<cWC^&bt%q(ZN3^s+Z9=n#TC9^*`geM_3IWbK%_a#KOTrJbG_&AEVWig#G54e;$*0YT)oh^~LL#SC"
        "Z%`u2M%e02CyS5{=IXEA(+BLT?Ij;#elet~BmbGEFD!An+j;jwi_%nex7PpWyIWCg5O{)R3&@Rz9^s~{d$E`rCjjstdh_}c&iZjzGb+!"
        "sQ9=M}3A+S!eF)|l5X*H^~EVOX7HZsbs9yG$YWwZS_Lb3U>$tDjm)3;$Y6SC;B1T9UkkTH2SZZKdnp|||7x3XC`_@rkpRk`dms<9}n#j"
        "+~58#_NW04D=7EwuTwdb6ya2C5)A;4GjoQZ@0dC9=}EBs9?}xim7lfH}jo?XufAlC_(!hA@)24mc?_pQwMYi>Q#X_O(<wz%x8E*{o2lo"
        "VP-;QL~LTAvJz5+cZKf|GBWUexRl}NHu%B47JlVL#c+l",
    ),
)
